#!/bin/bash
# Starts what `make dist` made in a root that holds the C library and nothing else: from the tarball, then from the
# Debian package. No Rust, no Python, no network.
set -euo pipefail
cd "$(dirname "$0")/../.."
out=target/dist
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# Only what the program needs of the system: what `ldd` names outside its own folder.
bare_root() {
    local root="$1"
    mkdir -p "$root"/{proc,dev,tmp,data,bin}
    ldd "$out"/flip-*-linux/flip "$out"/flip-*-linux/lib/*.so* | awk '$3 ~ /^\// && $3 !~ /\/dist\// { print $3 } $1 ~ /^\/lib/ { print $1 }' \
        | sort -u | grep -v "$PWD" | xargs -I{} cp --parents -L {} "$root/"
}

# A root of its own, without the network but its own loopback; root outside is not needed where user namespaces are.
# Runs a shell command in which `flip` is the program inside that root.
inside() {
    local root="$1" flip="$2" command="$3"
    PATH="$PATH:/usr/sbin:/sbin" unshare --map-root-user --mount --pid --fork --net bash -euc '
        mount -t proc proc "$1/proc" 2> /dev/null || true
        for device in null urandom; do touch "$1/dev/$device"; mount --bind "/dev/$device" "$1/dev/$device"; done
        ip link set lo up
        flip() { env -i HOME=/ "$(command -v chroot)" "$root" "$program" "$@"; }
        root=$1 program=$2; eval "$3"' bash "$root" "$flip" "$command"
}

try() {
    echo "== $1"
    inside "$2" "$3" '
        flip --version
        flip doctor --data-dir /data/flip
        flip heap --seed 1 --data-dir /data/flip
        flip policy list --data-dir /data/flip > /dev/null
        flip audit verify --data-dir /data/flip
        flip serve --data-dir /data/flip --listen 127.0.0.1:8080 > /dev/null 2>&1 &
        for _ in $(seq 50); do sleep 0.2; flip health --listen 127.0.0.1:8080 > /dev/null 2>&1 && break; done
        flip health --listen 127.0.0.1:8080'
}

bare_root "$work/tar"
tar -C "$work/tar" -xJf "$out"/*.tar.xz
try "tarball" "$work/tar" "/$(basename "$out"/flip-*-linux)/flip"
bare_root "$work/deb"
dpkg-deb -x "$out"/*.deb "$work/deb"
try "Debian package" "$work/deb" /usr/bin/flip
