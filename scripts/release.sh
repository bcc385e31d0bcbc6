#!/usr/bin/env bash
# release.sh [FOLDER] - what a user without a compiler unpacks and runs, from the last commit: FOLDER (build/release) gets a zip for each
# machine, the source archive, and SHA256SUMS. `release.sh source FILE`: the source archive alone. `release.sh list`: the files beside the programs.
#
# Debian: what scripts/cross.sh and `make wasm` need, zip, libstb-dev. The same commit and compilers give the same bytes: sorted names,
# the commit's time, no time in the programs. They are built from the source archive, which has stb's headers and so builds offline.
set -eu
cd "$(dirname "$0")/.."
export LC_ALL=C TZ=UTC
commit=$(git rev-parse HEAD)
# What oceanxl-lab says that it was built from: this, not the tree that the source archive is unpacked in.
LAB_COMMIT=$(git rev-parse --short=8 "$commit")
export LAB_COMMIT
machines='linux-x86-64 linux-aarch64 windows-x86-64'
stb=${STB:-/usr/include/stb}
name=oceanxl-$(git show "$commit:oceanxl.h" | sed -n 's/^#define OXL_VERSION "\(.*\)"$/\1/p')

beside() { # the documents, the viewer, the course, the examples and the method in one file, at the places that the documents name
    git ls-tree -r --name-only "$commit" README.md CHANGELOG.md CONTRIBUTING.md LICENSE docs/ examples/ reference/
    echo examples/playground/trained.html
    echo START.txt
}

source_archive() { # FILE
    git archive --format=tar --prefix="$name/stb/" --add-file="$stb/stb_image.h" --add-file="$stb/stb_image_write.h" --prefix="$name/" "$commit" |
        gzip -9n >"$1"
}

start() { # MACHINE
    local program=./oceanxl libc='musl (MIT licence)'
    case $1 in
    linux-aarch64) libc="glibc (LGPL: $name.tar.gz builds the program again with another)" ;;
    windows*) program=oceanxl.exe libc="mingw-w64's runtime (public domain and MIT)" ;;
    esac
    cat <<END
$name for $1. Nothing needs to be installed, and no network is used. Type in a terminal, in this folder:

    $program check SURVEY          what is there, time and memory; SURVEY holds images/ and sparse/0/ of COLMAP
    $program train SURVEY -o out   writes out/scene.ply and out/report.html
    $program synth -o survey       makes a survey, where you have none

Where the documents say build/oceanxl, it is $program here. In a browser, each a page that works offline:

    examples/viewer/index.html         looks at out/scene.ply
    examples/course/index.html         teaches the method
    examples/playground/trained.html   trains a survey in the page

README.md leads to the documents; docs/GUIDE.md goes from photos to a map. What needs make or Python is in $name.tar.gz.
The programs hold parts of libgomp (GPL with the GCC runtime library exception), stb (public domain or MIT) and $libc.
END
}

# MACHINE STAGE OUT: the zip of a machine, from the programs built in STAGE/MACHINE.
pack() {
    local root=$2/zip/$name-$1 file
    mkdir -p "$root"
    git archive "$commit" README.md CHANGELOG.md CONTRIBUTING.md LICENSE docs examples reference | tar -x -C "$root"
    cp "$2/$name/build/playground/index.html" "$root/examples/playground/trained.html"
    start "$1" >"$root/START.txt"
    for file in "$2/$1/oceanxl" "$2/$1/oceanxl-lab"; do
        if [ -e "$file.exe" ]; then cp "$file.exe" "$root"; else cp "$file" "$root"; fi
    done
    find "$root" -exec touch -d "@$(git show -s --format=%ct "$commit")" {} +
    chmod -R u=rwX,go=rX "$root"
    rm -f "$3/$name-$1.zip"
    (cd "$2/zip" && find "$name-$1" -type f | sort | zip -9 -X -q -@ "$3/$name-$1.zip")
}

case ${1:-} in
list) beside; exit ;;
source) source_archive "$2"; exit ;;
esac
out=${1:-build/release} stage=build/release.stage
[ -z "$(git status --porcelain --untracked-files=no)" ] || echo 'release.sh: the last commit is taken, without what has changed since' >&2
rm -rf "$stage"
mkdir -p "$out" "$stage"
out=$(realpath "$out")
source_archive "$out/$name.tar.gz"
tar -x -z -f "$out/$name.tar.gz" -C "$stage"
make -C "$stage/$name" CC="${CC:-cc}" STB=stb wasm
for machine in $machines; do
    (cd "$stage/$name" && LDFLAGS=-s STB=stb scripts/cross.sh "$machine" "../$machine" oceanxl oceanxl-lab) ||
        { echo "release.sh: $machine was not built" >&2; exit 1; }
    pack "$machine" "$stage" "$out"
done
(cd "$out" && sha256sum "$name".tar.gz "$name"-*.zip | tee SHA256SUMS)
