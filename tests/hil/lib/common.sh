# Common to all parts: places, the key of a cache, what to do when something cannot be had.
hil=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
root=$(cd "$hil/../.." && pwd)
made=${GONIOD_HIL_DIR:-$root/target/hil}
mkdir -p "$made"

# True where the bench must run: in CI, or when asked for.
required() { [ "${GONIOD_HIL:-}" = require ] || [ "${CI:-}" = 1 ] || [ "${CI:-}" = true ]; }

# The bench cannot run. Local: said loudly; where it is required: a failure.
cannot() {
    if required; then
        echo "hil: FAILED: $*" >&2
        echo "0 passed, 1 failed, 0 skipped"
        exit 1
    fi
    echo "hil: ========== SKIPPED: $* ==========" >&2
    echo "0 passed, 0 failed, 1 skipped"
    exit 0
}

as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@"; fi; }

key() { sha256sum | cut -c1-16; }

# Time since the last call, for the budget.
lap() {
    local now; now=$(date +%s%N)
    echo "hil: $1 $(((now - ${last_lap:-$now}) / 1000000)) ms"
    last_lap=$now
}
