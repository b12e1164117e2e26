#!/usr/bin/env bash
# Installs a bundle in a root without a network, and runs a simulated cell from it: try.sh BUNDLE.tar.gz. As root; leaves
# nothing behind. The root has Debian's /usr of this machine, read-only and without /usr/local, and nothing else of it: no
# home, no cache, no configuration of pip. With --mmdebstrap it is a new minimal root of Debian 12 instead, for which
# mmdebstrap must be installed and packages reachable.
set -euo pipefail
source=
[[ $1 != --mmdebstrap ]] || { source=mmdebstrap; shift; }
bundle=$(realpath "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
root=$work/root

if [[ -n $source ]]; then
    mmdebstrap --quiet --variant=minbase --include=python3,libgomp1 bookworm "$root"
else
    mkdir -p "$root"/{usr,etc,proc,dev,run,opt,root,var/lib,tmp}
    for name in bin lib lib64 sbin; do ln -s "usr/$name" "$root/$name"; done
    cp /etc/{passwd,group,ld.so.cache,nsswitch.conf} "$root/etc"
fi
mkdir -p "$root/opt/bundle"
tar -xzf "$bundle" -C "$root/opt/bundle" --strip-components=1
cat >"$root/opt/try" <<'PROGRAM'
set -euo pipefail
if python3 -c 'import socket; socket.create_connection(("192.0.2.1", 80), 1)' 2>/dev/null; then
    echo "there is a network" >&2
    exit 1
fi
/opt/bundle/install.sh
export PATH=/opt/pcmrs/bin:$PATH
pcmrs --version
pcmrs-serve --set cell.folder=/var/lib/cell --set console.enabled=false >/tmp/served 2>/tmp/log &
daemon=$!
for _ in {1..1200}; do
    grep -qx ready /tmp/served && break
    kill -0 $daemon || { cat /tmp/log; exit 1; }
    sleep 0.1
done
pcmrs call robot.connect
pcmrs backup /root/copy --set cell.folder=/var/lib/cell
kill $daemon
wait $daemon
pcmrs restore /root/copy /var/lib/restored
pcmrs journal verify /var/lib/restored/ratms.sqlite
PROGRAM
# The namespaces end with the program, and so do its mounts and processes.
unshare --mount --net --pid --fork --kill-child bash -euo pipefail -c '
    root=$1
    if [[ -z $2 ]]; then
        mount --rbind --make-rslave /usr "$root/usr"
        mount -o remount,bind,ro "$root/usr"
        mount -t tmpfs -o size=1m none "$root/usr/local"
    fi
    mount -t proc proc "$root/proc"
    mount -t tmpfs -o size=512m none "$root/tmp"
    mount --rbind /dev "$root/dev"
    ip link set lo up 2>/dev/null || true
    exec chroot "$root" /usr/bin/env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 bash /opt/try
' try "$root" "$source"
echo "the bundle was installed and used without a network, in ${source:-the /usr of this machine}"
