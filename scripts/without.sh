#!/bin/sh
# without.sh PART [WORD...] - removes a part of training, its file and its row, in a copy of the tree (build/without/PART), builds it, and
# runs the tests whose names contain one of the words (all). Tests that need the part say so (NEEDS_PART) and are skipped.
#
# Objects are taken from build/dev, so that no more is compiled than what the removal changes: the proof is that it links and works.
set -eu
cd "$(dirname "$0")/.."
part=$1
shift
[ -e "src/parts/$part.c" ] || { echo "without: src/parts has no $part.c; parts are: $(sed -n 's/^ *ROW(\(.*\)).*/\1/p' src/parts/parts.h | tr '\n' ' ')" >&2; exit 2; }
tree=build/without/$part
make -s DEV=1 build/dev/oceanxl build/dev/test
rm -rf "$tree"
mkdir -p "$tree/build"
tar -cf - --exclude=./build --exclude=./dist --exclude=./demo --exclude=./.git . | tar -xf - -C "$tree"
cp -a build/dev "$tree/build/dev"
cd "$tree"
rm -f "src/parts/$part.c" "src/parts/$part.h" "tests/test_$part.c" "build/dev/src/parts/$part".* "build/dev/tests/test_$part".*
sed -i "/ROW($part) /d; s/ROW($part)\$//" src/parts/parts.h
sed -i "/src\/parts\/$part\.c/d" oceanxl.c
grep -q "ROW($part)" src/parts/parts.h && { echo "without: the row of $part is still there" >&2; exit 1; }
make -s DEV=1 build/dev/oceanxl build/dev/test
build/dev/test "$@"
