#!/usr/bin/env bash
# A virtual environment in the checkout, with pinned versions of what its user needs.
# usage: scripts/setup.sh fly | view | campaign | compare | dev | fuzz
# The other scripts source it:  . scripts/setup.sh fly [uncompiled]
cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 1
python=${PYTHON:-python3}
venv=${VENV:-.venv}
pins=requirements/${1:-}.txt
if [ ! -f "$pins" ] || [ "$1" = build ]; then
    echo "error: setup for '${1:-}': there is no such set. Give one of fly, view, campaign, compare, dev, fuzz." >&2
    exit 2
fi
if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
    echo "error: PYTHON = '$python': Python 3.11 or newer is needed. Install it, or set PYTHON." >&2
    exit 2
fi
compiles='import contextlib, pkgutil, companion, vehicle_sim # all that both programs are made of
for each in (companion, vehicle_sim):
    for module in pkgutil.walk_packages(each.__path__, each.__name__ + "."):
        with contextlib.suppress(ModuleNotFoundError): # vehicle_sim.testing: pytest is for developers
            module.name.endswith("__main__") or __import__(module.name)
companion.runtime.compiler.load_proof()'
stamp="$venv/.installed-$1"
wanted=$(cat "$pins" requirements/build.txt pyproject.toml | cksum)
if [ "$(cat "$stamp" 2>/dev/null)" != "$wanted" ]; then
    if ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
        echo "error: this Python has no venv. On Debian or Ubuntu: sudo apt install python3-venv" >&2
        exit 2
    fi
    echo "setting up $venv for '$1' (once, about a minute) ..."
    install() { "$venv/bin/pip" install -q --no-compile --disable-pip-version-check "$@"; }
    # what builds the project lies beside it only while it does
    "$python" -m venv "$venv" && install --require-hashes -r "$pins" &&
        install --require-hashes -r requirements/build.txt --target "$venv/build" &&
        PYTHONPATH=$(realpath "$venv/build") install --no-deps --no-build-isolation -e . &&
        rm -r "$venv/build" || exit 1
    echo "$wanted" >"$stamp"
fi
if [ "${2:-}" != uncompiled ] && [ "$(cat "$stamp-compiled" 2>/dev/null)" != "$wanted" ]; then
    unset PYTHONDONTWRITEBYTECODE
    "$venv/bin/python" -c "$compiles" & # beside the search, which takes longest
    "$venv/bin/python" -c 'from companion.runtime.compiler import load_kernel; load_kernel()' && wait $! || exit 1
    echo "$wanted" >"$stamp-compiled"
fi
