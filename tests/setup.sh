#!/usr/bin/env bash
# Installs what the project needs on a bare Debian machine with Rust:
#   setup.sh packages   Debian packages to build and run
#   setup.sh python     a local .venv with the third-party readers that tests compare with
set -euo pipefail
cd "$(dirname "$0")/.."

packages=(build-essential pkg-config libhdf5-dev python3 python3-venv libclang-dev linux-libc-dev libaravis-dev libusb-1.0-0-dev aravis-tools-cli indi-bin)

as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi; }

install_packages() {
    local missing=()
    for p in "${packages[@]}"; do
        dpkg-query -W -f='${Status}' "$p" 2>/dev/null | grep -q 'install ok installed' || missing+=("$p")
    done
    [ ${#missing[@]} = 0 ] && return
    echo "setup: installing ${missing[*]}"
    as_root apt-get update -qq
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
}

install_python() {
    local stamp=.venv/requirements.installed
    cmp -s tests/peers/requirements.txt "$stamp" && return
    echo "setup: third-party readers into .venv"
    if /usr/bin/python3 -m venv .venv && .venv/bin/pip install -q --disable-pip-version-check -r tests/peers/requirements.txt; then
        cp tests/peers/requirements.txt "$stamp"
    else
        echo "setup: the third-party readers could not be installed; their tests will say SKIPPED" >&2
    fi
}

case "${1:-}" in
    packages) install_packages ;;
    python) install_python ;;
    *) echo "usage: setup.sh packages|python" >&2; exit 2 ;;
esac
