#!/bin/sh
# deb.sh [FOLDER] - builds oceanxl and writes FOLDER/oceanxl_VERSION_ARCH.deb (FOLDER: build). Needs dpkg-deb (Debian: dpkg).
set -eu
cd "$(dirname "$0")/.."
out=${1:-build}
mkdir -p "$out"
version=$(sed -n 's/^#define OXL_VERSION "\(.*\)"$/\1/p' oceanxl.h)
arch=$(dpkg --print-architecture)
root=$(mktemp -d)
chmod 755 "$root"
trap 'rm -rf "$root"' EXIT
make CFLAGS='-O3' DESTDIR="$root" PREFIX=/usr install
gzip -9n "$root/usr/share/man/man1/oceanxl.1"
strip "$root/usr/bin/oceanxl" "$root/usr/bin/oceanxl-lab"
install -D -m 644 LICENSE "$root/usr/share/doc/oceanxl/copyright"
mkdir "$root/DEBIAN"
cat >"$root/DEBIAN/control" <<EOF
Package: oceanxl
Version: $version
Architecture: $arch
Maintainer: OceanXL authors <nobody@localhost>
Section: graphics
Priority: optional
Depends: libc6, libgomp1
Installed-Size: $(du -sk "$root/usr" | cut -f 1)
Description: 3D Gaussian Splatting of large underwater surveys
 Turns a COLMAP export of an underwater survey into one compact model of 3D
 Gaussians, on the CPU. Holds the program, oceanxl-lab (synthetic surveys and
 studies), the manual page, the headers and the static library.
EOF
dpkg-deb --root-owner-group --build "$root" "$out/oceanxl_${version}_$arch.deb"
