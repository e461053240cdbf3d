# Host programs: the emulator, a static shell for the guest, kernel module tools.

need_packages() {
    local missing=() version
    command -v qemu-system-x86_64 >/dev/null || missing+=(qemu-system-x86)
    [ -x /bin/busybox ] || missing+=(busybox-static)
    { [ -x /sbin/depmod ] || command -v depmod >/dev/null; } || missing+=(kmod)
    command -v cpio >/dev/null || missing+=(cpio)
    { command -v gcc && command -v make; } >/dev/null || missing+=(build-essential)
    [ ${#missing[@]} = 0 ] && return
    echo "hil: installing ${missing[*]}"
    as_root apt-get update -qq || true
    # An image may carry qemu-utils of another release, which would not stay beside this emulator: both in one step.
    if [[ " ${missing[*]} " == *" qemu-system-x86 "* ]] && dpkg -s qemu-utils >/dev/null 2>&1; then
        version=$(apt-cache policy qemu-system-x86 | awk '/Candidate:/ { print $2 }')
        missing+=("qemu-utils=$version" "qemu-system-x86=$version")
    fi
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends --allow-downgrades \
        "${missing[@]}" >"$made/apt.log" 2>&1
}
