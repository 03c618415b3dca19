# Sourced by scripts/test where the tests in a browser must run: Debian's Chromium, if there is none.
# usage: . scripts/setup-browser.sh
if ! command -v chromium >/dev/null; then
    if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
        echo "error: the tests in a browser need Chromium. On Debian, as root: apt-get install chromium" >&2
        exit 2
    fi
    echo "installing chromium (once) ..."
    export DEBIAN_FRONTEND=noninteractive
    apt_get() { apt-get -qq -o Acquire::Retries=3 -o DPkg::Lock::Timeout=300 "$@" </dev/null; }
    report=$(mktemp) || exit 1
    if ! { apt_get update && apt_get install -y --no-install-recommends chromium; } >"$report" 2>&1; then
        cat "$report" >&2
        echo "error: chromium could not be installed. Look above for the reason." >&2
        exit 1
    fi
    rm "$report"
fi
