#!/bin/bash
# A tarball and a Debian package of what `cargo build --release` built: the program, the libraries it links, manual
# pages, completions, a systemd unit. Both run where there is no Rust, Python or network. Called by `make dist`.
set -euo pipefail
cd "$(dirname "$0")/../.."
binary="${CARGO_TARGET_DIR:-target}/release/flip"
version=$("$binary" --version | awk '{ print $2 }')
[ "$(uname -m)" = x86_64 ] || { echo "only x86-64 is packed, this is $(uname -m)" >&2; exit 1; }
name="flip-$version-x86_64-linux"
out=target/dist
root="$out/$name"
rm -rf "$out"
mkdir -p "$root/lib" "$root/share/man/man1" "$root/share/completions"

cp "$binary" "$root/flip"
strip "$root/flip"
# What the program links of libtorch, and no more; the C library and its like are the system's.
ldd "$binary" | awk '$3 ~ /\.libtorch\/lib\// { print $3 }' | xargs -I{} cp -L {} "$root/lib/"
strip --strip-unneeded "$root"/lib/*.so*
cp README.md "$root/"
[ ! -e LICENSE ] || cp LICENSE "$root/"
cp .ci/dist/flip.service .ci/dist/flip.toml "$root/share/"
"$root/flip" man "$root/share/man/man1" > /dev/null
for shell in bash zsh fish; do "$root/flip" completions "$shell" > "$root/share/completions/flip.$shell"; done
tar -C "$out" --sort=name --owner=0 --group=0 --numeric-owner --mtime="@${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct)}" -c "$name" \
    | xz -T0 -6 > "$out/$name.tar.xz"

# The same for dpkg.
deb="$out/deb"
mkdir -p "$deb/DEBIAN" "$deb/opt" "$deb/usr/bin" "$deb/usr/share/man" "$deb/usr/share/bash-completion/completions" \
    "$deb/lib/systemd/system" "$deb/etc/flip"
cp -r "$root" "$deb/opt/flip"
mv "$deb/opt/flip/share/man/man1" "$deb/usr/share/man/man1"
gzip -n9 "$deb/usr/share/man/man1/"*.1
mv "$deb/opt/flip/share/completions/flip.bash" "$deb/usr/share/bash-completion/completions/flip"
mv "$deb/opt/flip/share/flip.service" "$deb/lib/systemd/system/"
mv "$deb/opt/flip/share/flip.toml" "$deb/etc/flip/"
ln -s /opt/flip/flip "$deb/usr/bin/flip"
echo /etc/flip/flip.toml > "$deb/DEBIAN/conffiles"
cat > "$deb/DEBIAN/control" <<CONTROL
Package: flip-weighing
Version: $version
Architecture: amd64
Maintainer: The FLIP authors <flip@localhost>
Section: science
Priority: optional
Installed-Size: $(du -sk "$deb" | cut -f1)
Depends: libc6 (>= 2.34), libstdc++6, libgcc-s1, adduser
Description: flowability-informed powder weighing
 A lab service that measures how a powder piles, calibrates a simulator until its
 piles match, learns to weigh in it, and makes a bench stop at the right milligram.
CONTROL
cat > "$deb/DEBIAN/postinst" <<'POSTINST'
#!/bin/sh
set -e
if [ "$1" = configure ] && ! getent passwd flip > /dev/null; then
    adduser --system --group --no-create-home --home /var/lib/flip flip
fi
[ ! -d /run/systemd/system ] || systemctl daemon-reload
POSTINST
cat > "$deb/DEBIAN/prerm" <<'PRERM'
#!/bin/sh
set -e
[ "$1" != remove ] || [ ! -d /run/systemd/system ] || systemctl disable --now flip
PRERM
chmod 0755 "$deb/DEBIAN/postinst" "$deb/DEBIAN/prerm"
dpkg-deb --root-owner-group -Zxz --build "$deb" "$out/flip-weighing_${version}_amd64.deb" > /dev/null
rm -rf "$deb"
du -h "$out"/*.tar.xz "$out"/*.deb
du -sh "$root"
