#!/usr/bin/env bash
# Runs formatting, lints and every test of the workspace, then prints the sum over all test programs as its last line.
set -uo pipefail
cd "$(dirname "$0")/.."

log=$(mktemp)
hil_log=$(mktemp)
trap 'rm -f "$log" "$hil_log"' EXIT

cargo fmt --all -- --check \
    && cargo clippy --workspace --all-targets --all-features --quiet -- -D warnings \
    && cargo clippy -p goniod --no-default-features --quiet -- -D warnings \
    && cargo clippy -p goniod --quiet -- -D warnings
lints=$?
[ $lints = 0 ] || echo "run.sh: formatting, lints or a combination of features failed"

cargo test --workspace --all-features --no-fail-fast -- "$@" 2>&1 | tee "$log"
tests=${PIPESTATUS[0]}

# The virtual bench, unless single tests were asked for or it is left out.
hil=0
if [ $# = 0 ] && [ "${GONIOD_HIL:-}" != skip ]; then
    bash tests/hil/run 2>&1 | tee "$hil_log"
    hil=${PIPESTATUS[0]}
fi

# What went wrong once more, where a reader of the last lines finds it.
{
    [ $lints = 0 ] || echo "run.sh: formatting, lints or a combination of features failed, see the beginning"
    [ "$tests" = 0 ] || grep -hE "^error|^  process didn't exit|^test .* FAILED$|^    .*(--test|--lib|--bin|--doc)|panicked at" "$log" | tail -n 60
    [ "$hil" = 0 ] || echo "run.sh: the virtual bench failed"
}
# A test program that ended without a result, and lints, count as a failure each.
awk -v lints="$lints" '/^ +(Running|Doc-tests) / { begun++ } /^test result:/ { ended++; p += $4; f += $6; s += $8 }
    /^[0-9]+ passed, [0-9]+ failed, [0-9]+ skipped$/ { p += $1; f += $3; s += $5 }
    END { printf "%d passed, %d failed, %d skipped\n", p, f + begun - ended + (lints != 0), s }' "$log" "$hil_log"
[ "$tests" = 0 ] && [ "$lints" = 0 ] && [ "$hil" = 0 ]
