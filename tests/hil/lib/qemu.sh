# The one command line of the guest. Software emulation only, no network card; ttyS1 carries results, ttyS2 and a USB
# adapter end at the bench's sockets.

# run_guest DIR INITRAMFS LIMIT_SECONDS
run_guest() {
    local dir=$1 initramfs=$2 limit=$3
    timeout -k 10 "$limit" qemu-system-x86_64 -no-reboot -nographic -nodefaults -M q35 \
        -accel tcg,thread=multi -cpu max -smp 2 -m 1024 \
        -kernel "$kernel/vmlinux" -initrd "$initramfs" \
        -append "console=ttyS0 panic=-1 quiet mitigations=off" \
        -serial "file:$dir/guest.log" \
        -chardev "socket,id=results,path=$dir/results.sock" -device isa-serial,chardev=results,index=1 \
        -chardev "socket,id=line,path=$dir/line.sock" -device isa-serial,chardev=line,index=2 \
        -device qemu-xhci,id=xhci \
        -chardev "socket,id=adapter,path=$dir/adapter.sock,reconnect=1" \
        -device usb-serial,chardev=adapter,bus=xhci.0,id=adapter0 \
        -monitor "unix:$dir/monitor.sock,server=on,wait=off" </dev/null >"$dir/qemu.log" 2>&1
}
