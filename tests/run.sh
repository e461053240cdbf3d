#!/usr/bin/env bash
# Runs formatting, lints and every test of the workspace, then prints the sum over all test programs as its last line.
# Test programs run two at a time: many of them wait for real time. Arguments go to each of them (`--nocapture`, a name).
set -uo pipefail
cd "$(dirname "$0")/.."

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# Name, working folder and path of each test program, from what cargo says it built; the long ones first.
programs() {
    python3 - "$1" <<'PY'
import json, os, sys
LONG = ["night", "validate", "labels", "cut_products", "cuts", "resume", "daemon", "first_light", "peers", "simulate", "gige", "v4l2"]
found = []
for line in open(sys.argv[1]):
    built = json.loads(line) if line.startswith("{") else {}
    if built.get("executable") and built["profile"]["test"]:
        package = os.path.dirname(built["manifest_path"])
        name, kind = built["target"]["name"], built["target"]["kind"][0]
        place = LONG.index(name) if kind == "test" and name in LONG else len(LONG)
        where, _, which = built["package_id"].rpartition("#")
        crate = which.split("@")[0] if "@" in which else os.path.basename(where)
        found.append((place, f"{crate}-{kind}-{name}", package, built["executable"]))
for _, name, package, path in sorted(found):
    print(name, package, path, sep="\t")
PY
}

# One program in its package's folder; its whole output at once when it has ended.
run_one() {
    IFS=$'\t' read -r name package path <<<"$1"
    local log="$work/$name.log" began=$SECONDS
    (cd "$package" && exec "$path" "${@:2}") >"$log" 2>&1
    local code=$?
    [ $code = 0 ] || echo "run.sh: $name ended with code $code" | tee -a "$work/failed" >>"$log"
    { echo; echo "     Ran $name ($((SECONDS - began)) s)"; cat "$log"; }
}
export -f run_one
export work

# Lints of every combination of features that is promised; beside the tests, in the time they wait.
lints() {
    cargo fmt --all -- --check \
        && cargo clippy --workspace --all-targets --all-features --quiet -- -D warnings \
        && cargo clippy -p goniod --no-default-features --quiet -- -D warnings \
        && cargo clippy -p goniod --quiet -- -D warnings
}

cargo test --workspace --all-features --no-run --message-format=json-render-diagnostics >"$work/built.json"
built=$?
programs "$work/built.json" >"$work/programs"
(lints >"$work/lints.log" 2>&1) &
linting=$!
xargs -d '\n' -P 2 -I{} bash -c 'run_one "$@"' run_one {} "$@" <"$work/programs"
wait $linting
lints=$?
[ $lints = 0 ] || cat "$work/lints.log"

# The virtual bench, unless single tests were asked for or it is left out.
hil=0
touch "$work/hil.log"
if [ $# = 0 ] && [ "${GONIOD_HIL:-}" != skip ]; then
    bash tests/hil/run 2>&1 | tee "$work/hil.log"
    hil=${PIPESTATUS[0]}
fi

# What went wrong once more, where a reader of the last lines finds it.
[ $lints = 0 ] || echo "run.sh: formatting, lints or a combination of features failed, see above"
[ $built = 0 ] || echo "run.sh: the tests could not be built, see the beginning"
[ $hil = 0 ] || echo "run.sh: the virtual bench failed"
grep -hE "^test .* FAILED$|panicked at|^error|^run.sh: " "$work"/*.log | tail -n 60
[ -s "$work/failed" ] && cat "$work/failed"

# Lints, a build that failed and a program that ended without a result count as a failure each.
count=$(wc -l <"$work/programs")
awk -v other=$(((lints != 0) + (built != 0))) -v begun="$count" '
    /^test result:/ { ended++; p += $4; f += $6; s += $8 }
    /^[0-9]+ passed, [0-9]+ failed, [0-9]+ skipped$/ { p += $1; f += $3; s += $5 }
    END { printf "%d passed, %d failed, %d skipped\n", p, f + other + (begun > ended ? begun - ended : 0), s }' "$work"/*-*.log "$work/hil.log"
[ $lints = 0 ] && [ $built = 0 ] && [ $hil = 0 ] && [ ! -e "$work/failed" ]
