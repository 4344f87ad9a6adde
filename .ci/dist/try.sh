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

# A root of its own, without the network; root outside is not needed where user namespaces are.
inside() {
    local root="$1"
    shift
    unshare --map-root-user --mount --pid --fork --net sh -c '
        mount -t proc proc "$1/proc" 2> /dev/null || true
        touch "$1/dev/null"; mount --bind /dev/null "$1/dev/null"
        touch "$1/dev/urandom"; mount --bind /dev/urandom "$1/dev/urandom"
        [ ! -x /sbin/ip ] || /sbin/ip link set lo up
        root=$1; shift; exec env -i HOME=/ chroot "$root" "$@"' sh "$root" "$@"
}

try() {
    local what="$1" root="$2" flip="$3"
    echo "== $what"
    inside "$root" "$flip" --version
    inside "$root" "$flip" doctor --data-dir /data/flip
    inside "$root" "$flip" repose --seed 1 --data-dir /data/flip
    inside "$root" "$flip" policy list --data-dir /data/flip > /dev/null
    inside "$root" "$flip" audit verify --data-dir /data/flip
}

bare_root "$work/tar"
tar -C "$work/tar" -xJf "$out"/*.tar.xz
try "tarball" "$work/tar" "/$(basename "$out"/flip-*-linux)/flip"
bare_root "$work/deb"
dpkg-deb -x "$out"/*.deb "$work/deb"
try "Debian package" "$work/deb" /usr/bin/flip
