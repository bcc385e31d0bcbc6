#!/bin/sh
# release.sh - what can be held of a release in seconds: the source archive is the same twice, has stb and builds without the system's;
# what the README names is beside the programs; a build without SSE2 is warned of in one line. .ci/slow makes the release.
set -u
cd "$(dirname "$0")/.." || exit 1
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
passed=0 failed=0
promise() { # NAME COMMAND...
    name=$1
    shift
    if "$@" >"$folder/out" 2>&1; then passed=$((passed + 1)) && echo "ok   $name"; else
        failed=$((failed + 1)) && echo "FAIL $name" && head -n 20 "$folder/out"
    fi
}
twice() {
    scripts/release.sh source "$folder/a.tar.gz" && sleep 1 && touch Makefile && scripts/release.sh source "$folder/b.tar.gz" &&
        cmp "$folder/a.tar.gz" "$folder/b.tar.gz"
}
builds() { # the file that includes stb; the compiler is not to look in /usr/include/stb
    tar -x -z -f "$folder/a.tar.gz" -C "$folder" && (cd "$folder"/oceanxl-* &&
        env -u STB make -n all && env -u STB make OPENMP=0 CFLAGS=-O0 build/src/core/codec.o &&
        grep -q 'stb/stb_image.h' build/src/core/codec.d && ! grep '/usr/include/stb' build/src/core/codec.d)
}
named() { # links of the README, and what it tells users to open or run
    scripts/release.sh list >"$folder/list"
    { grep -o '](\([^):#]*\))' README.md | sed 's/](\(.*\))/\1/'; grep -oE 'examples/[a-z_/]+\.(html|sh|py)|reference/splat\.c' README.md; } |
        while read -r file; do grep -qE "^$file(/|\$)" "$folder/list" || { echo "$file is not in the release" && return 1; }; done
}
warns() {
    mkdir -p "$folder/32/gnu" && : >"$folder/32/gnu/stubs-32.h"
    make -s CC="gcc -m32 -I$folder/32 -idirafter /usr/include/x86_64-linux-gnu" OPENMP=0 BUILD="$folder/m32" "$folder/m32/flags" >"$folder/said" 2>&1
    make -s CC="gcc -m32 -msse2 -mfpmath=sse -I$folder/32 -idirafter /usr/include/x86_64-linux-gnu" OPENMP=0 BUILD="$folder/m32" "$folder/m32/flags" >>"$folder/said" 2>&1
    cat "$folder/said"
    [ "$(wc -l <"$folder/said")" = 1 ] && grep -q '8 times as slow' "$folder/said"
}
promise release_source_archive_is_the_same_twice twice
promise release_source_archive_builds_with_its_own_stb builds
promise release_has_what_the_readme_names named
promise release_warns_of_32_bits_without_sse2 warns
echo "$passed passed, $failed failed"
[ $failed = 0 ]
