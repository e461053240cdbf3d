#!/bin/sh
# Boots systemd as process 1 of namespaces of its own, over a copy-on-write view of this machine: boot.sh FOLDER.
# FOLDER holds `install.sh`, which puts files into the new root. Run by unshare; everything goes when it ends.
set -e
folder=$1
mount -t tmpfs tmpfs "$folder"/layers
mkdir "$folder"/layers/upper "$folder"/layers/work
mount -t overlay overlay -o "lowerdir=/,upperdir=$folder/layers/upper,workdir=$folder/layers/work" "$folder/root"
cd "$folder/root"
mount -t proc proc proc
mount -t tmpfs tmpfs run
mkdir run/lock
mount -t tmpfs tmpfs tmp
mount --rbind /dev dev
mount -t tmpfs tmpfs sys
mkdir -p sys/fs/cgroup
mount -t cgroup2 cgroup2 sys/fs/cgroup
rm -rf etc/systemd/system/*.wants
echo 0123456789abcdef0123456789abcdef >etc/machine-id
printf '[Unit]\nDescription=nothing but what is started by hand\n' >etc/systemd/system/empty.target
sh "$folder/install.sh" "$folder/root"
exec chroot . env -i container=other PATH=/usr/sbin:/usr/bin:/sbin:/bin \
    /lib/systemd/systemd --system --unit=empty.target --log-target=null --show-status=no
