"""How both programs end: an error is one line on stderr and an exit code, never a traceback."""

import errno
import os
import sys

import typer

from vehicle_sim.errors import InputError, SimulatorError


def run(app: typer.Typer, program: str) -> None:
    """Run a command line and exit; `program` is how its help page is asked for."""
    try:
        code = app(standalone_mode=False)
    except SimulatorError as error:
        typer.echo(f"error: {error}", err=True)
        sys.exit(error.exit_code)
    except typer.Abort:
        sys.exit(0)
    except OSError as error:
        if error.filename is not None or error.errno not in (errno.ENOSPC, errno.EPIPE, errno.EIO):
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # for what is not yet written
        sys.stderr.write(f"error: the output cannot be written ({error.strerror})\n")
        sys.exit(InputError.exit_code)
    except Exception as error:
        wrong = _wrong_options(error)
        if wrong is None:
            raise
        typer.echo(f"error: {wrong.rstrip('.')}. See {program} --help.", err=True)
        sys.exit(InputError.exit_code)
    sys.exit(code if isinstance(code, int) else 0)


def _wrong_options(error: Exception) -> str | None:
    """What is wrong with the options as such; None if the error is something else.

    Typer raises the parent class of its BadParameter, and has no name for it.
    """
    if not isinstance(error, typer.BadParameter.__bases__):
        return None
    return str(getattr(error, "format_message", error.__str__)())
