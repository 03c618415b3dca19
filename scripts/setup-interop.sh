# Sourced by scripts/test: other people's programs, pinned, by one pip; each has an environment
# of its own, for two exclude each other.
# usage: . scripts/setup-interop.sh [--all]    (what nightly tests alone need, too)
cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 1
interop=${INTEROP_VENVS:-.venv-interop}
mkdir -p "$interop" && echo '*' >"$interop/.gitignore" || exit 1
for wanted in tests/interop/requirements/*.txt; do
    name=$(basename "$wanted" .txt)
    [ "$name" = mavsdk-3 ] && [[ " $* " != *" --all "* ]] && continue
    stamp="$interop/$name/.installed"
    if [ "$(cat "$stamp" 2>/dev/null)" != "$(cksum <"$wanted")" ]; then
        echo "setting up $interop/$name (once) ..."
        rm -rf "${interop:?}/$name"
        [ -x "$interop/.pip/bin/pip" ] || "${PYTHON:-python3}" -m venv "$interop/.pip" || exit 1
        "${PYTHON:-python3}" -m venv --without-pip "$interop/$name" &&
            "$interop/.pip/bin/pip" --python "$interop/$name/bin/python" install -q --no-compile \
                --disable-pip-version-check --no-deps --require-hashes -r "$wanted" || exit 1
        cksum <"$wanted" >"$stamp"
    fi
done
export INTEROP_VENVS=$interop
