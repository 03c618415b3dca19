# Sourced by the other scripts: a virtual environment in the checkout, with pinned versions.
# usage: . scripts/setup.sh requirements.txt [uncompiled]
cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 1
python=${PYTHON:-python3}
venv=${VENV:-.venv}
if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
    echo "error: PYTHON = '$python': Python 3.11 or newer is needed. Install it, or set PYTHON." >&2
    exit 2
fi
compiles='import contextlib, pkgutil, companion, vehicle_sim # all that both programs are made of
for each in (companion, vehicle_sim):
    for module in pkgutil.walk_packages(each.__path__, each.__name__ + "."):
        with contextlib.suppress(ModuleNotFoundError): # vehicle_sim.testing: pytest is for developers
            module.name.endswith("__main__") or __import__(module.name)
companion.runtime.compiler.load_kernel()'
stamp="$venv/.installed-$1"
wanted=$(cat "$1" pyproject.toml | cksum)
if [ "$(cat "$stamp" 2>/dev/null)" != "$wanted" ]; then
    if ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
        echo "error: this Python has no venv. On Debian or Ubuntu: sudo apt install python3-venv" >&2
        exit 2
    fi
    echo "setting up $venv (once, about a minute) ..."
    "$python" -m venv "$venv" &&
        "$venv/bin/pip" install -q --no-compile --disable-pip-version-check --require-hashes -r "$1" &&
        "$venv/bin/pip" install -q --disable-pip-version-check --no-deps --no-build-isolation -e . ||
        exit 1
    echo "$wanted" >"$stamp"
fi
if [ "$2" != uncompiled ] && [ "$(cat "$stamp-compiled" 2>/dev/null)" != "$wanted" ]; then
    env -u PYTHONDONTWRITEBYTECODE "$venv/bin/python" -c "$compiles" || exit 1
    echo "$wanted" >"$stamp-compiled"
fi
