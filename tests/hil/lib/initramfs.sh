# The guest's only file system: a static shell, the modules named in guest/modules with what they need, the probe.

# make_initramfs FILE SUBJECTS_FILE
make_initramfs() (
    set -e
    out=$1 subjects=$2
    version=$(cat "$kernel/version")
    tree=$made/guest
    modules=$kernel/guest-modules
    # Stripped once a kernel and module list.
    stamp=$(cat "$hil/guest/modules" "$hil/lib/initramfs.sh" | key)
    if [ ! -f "$modules/$stamp" ]; then
        rm -rf "$modules" && mkdir -p "$modules"
        grep -v '^#' "$hil/guest/modules" | while read -r name parameters; do
            PATH=$PATH:/sbin:/usr/sbin modprobe -d "$kernel/image" -S "$version" --show-depends "$name" |
                awk '$1 == "insmod" { print $2 }' | while read -r path; do
                file=${path##*/}
                [ -f "$modules/$file" ] && continue
                strip --strip-debug "$path" -o "$modules/$file"
                wanted=$(basename "$file" .ko | tr - _)
                if [ "$wanted" = "$(echo "$name" | tr - _)" ]; then echo "/modules/$file $parameters"; else echo "/modules/$file"; fi
            done
        done >"$modules/load"
        touch "$modules/$stamp"
    fi
    rm -rf "$tree"
    mkdir -p "$tree"/{bin,dev,proc,sys,tmp,modules}
    cp /bin/busybox "$tree/bin/busybox"
    cp "$modules"/*.ko "$tree/modules/"
    cp "$modules/load" "$tree/modules.load"
    cp "$subjects" "$tree/subjects"
    cp "$probe" "$tree/goniod-hil"
    install -m 755 "$hil/guest/init" "$tree/init"
    (cd "$tree" && find . -print0 | cpio --quiet --null -o -H newc) >"$out"
)
