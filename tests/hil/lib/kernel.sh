# The guest's kernel: Debian's own, unpacked beside the system, never installed. Makes vmlinux, modules, v4l2loopback.

# Sets `kernel` to a folder with vmlinux, lib/modules and kernel-version; fails when it cannot be had.
fetch_kernel() {
    local version packages stamp
    version=$(apt-cache depends linux-image-amd64 2>/dev/null | grep -oP 'Depends: linux-image-\K[0-9][^ ]+-amd64$' | head -n 1)
    if [ -n "$version" ]; then
        local series=${version%%-*}
        packages=("linux-image-$version" "linux-headers-$version" "linux-headers-${version%-amd64}-common"
            "linux-kbuild-${series%.*}" v4l2loopback-dkms)
        # Headers name the compiler's package of their release.
        packages+=($(apt-cache depends "linux-headers-$version" 2>/dev/null | grep -oP 'linux-compiler-gcc-\S+'))
        stamp=$({ apt-cache show --no-all-versions "${packages[@]}" | grep -E '^(Package|Version):'; cat "$hil/lib/kernel.sh"; } | key)
        kernel=$made/kernel-$stamp
        [ -f "$kernel/done" ] && return
        rm -rf "$made"/kernel-* && mkdir -p "$kernel"
        unpack_kernel "$version" "${packages[@]}" >"$made/kernel.log" 2>&1 && touch "$kernel/done" && return
        echo "hil: the kernel could not be made; the end of $made/kernel.log:" >&2
        tail -n 5 "$made/kernel.log" >&2
    fi
    # Without the packages' list an earlier one will do.
    kernel=$(dirname "$(ls -t "$made"/kernel-*/done 2>/dev/null | head -n 1)" 2>/dev/null)
    [ -f "$kernel/done" ]
}

unpack_kernel() (
    set -e
    version=$1 && shift
    cd "$kernel"
    mkdir packages image headers
    (cd packages && apt-get download -qq "$@")
    dpkg-deb -x packages/linux-image-*.deb image
    for package in packages/*.deb; do
        case $package in */linux-image-*) ;; *) dpkg-deb -x "$package" headers ;; esac
    done
    rm -r packages
    # Booting the compressed image costs seconds at every start under emulation; the emulator takes the bare one.
    python3 - "image/boot/vmlinuz-$version" vmlinux <<'PYTHON'
import lzma, sys
packed = open(sys.argv[1], "rb").read()
start = packed.find(b"\xfd7zXZ\x00")
open(sys.argv[2], "wb").write(lzma.LZMADecompressor().decompress(packed[start:]))
PYTHON
    source=$kernel/headers/usr/src
    sed -i "s#/usr/src/#$source/#" "$source/linux-headers-$version/Makefile"
    cp -r "$source"/v4l2loopback-* loopback
    make -s -C "$source/linux-headers-$version" M="$kernel/loopback" CC=gcc modules
    mkdir -p "image/lib/modules/$version/extra"
    cp loopback/v4l2loopback.ko "image/lib/modules/$version/extra/"
    PATH=$PATH:/sbin:/usr/sbin depmod -b image "$version"
    echo "$version" >version
    rm -rf headers loopback
)
