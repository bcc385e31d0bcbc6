#!/bin/sh
# dist.sh DIR - the library in two files, DIR/oceanxl.h and DIR/oceanxl.c, and in one, DIR/single/oceanxl.h.
#
# Follows the front door, oceanxl.c, and puts each file that it includes in its place, once. One C file of the result is to
# say #define OCEANXL_IMPLEMENTATION before it includes the single header, ahead of every other header.
set -eu
cd "$(dirname "$0")/.."
out=${1:-dist}
mkdir -p "$out/single"

# emit(file): its text, with #include "..." replaced by the text of that file the first time and by nothing later.
# `api` stands where oceanxl.h is asked for.
amalgamate() {
    awk -v api="$1" '
    function folder(path) { sub(/[^\/]*$/, "", path); return path }
    function resolve(base, name) {
        name = folder(base) name
        while (sub(/[^\/.]+\/\.\.\//, "", name)) { } # a/../b is b
        return name
    }
    function emit(path,    line, name, got) {
        if (path in seen) return
        seen[path] = 1
        if (path ~ /^backends\//) { print "#error \"the Vulkan backend is built from the tree alone\""; return }
        if (path == "oceanxl.h") { if (api != "") print api; return }
        printf "\n/* ================================================================ %s */\n\n", path
        while ((got = getline line < path) > 0) {
            if (line ~ /^#include "/) {
                name = line; sub(/^#include "/, "", name); sub(/".*/, "", name)
                emit(resolve(path, name))
            } else print line
        }
        if (got < 0) { print "dist.sh: cannot read " path > "/dev/stderr"; exit 1 }
        close(path)
    }
    BEGIN { emit("oceanxl.c") }'
}

version=$(sed -n 's/^#define OXL_VERSION "\(.*\)"/\1/p' oceanxl.h)
{
    echo "/* OceanXL $version, amalgamated from its modules by scripts/dist.sh: do not edit. */"
    amalgamate '#include "oceanxl.h"'
} >"$out/oceanxl.c"
cp oceanxl.h "$out/oceanxl.h"
{
    echo "/* OceanXL $version in one header, made by scripts/dist.sh: do not edit."
    echo " *"
    echo " * In exactly one C file, ahead of every other header:"
    echo " *"
    echo " *     #define OCEANXL_IMPLEMENTATION"
    echo " *     #include \"oceanxl.h\""
    echo " *"
    echo " * and compile that file with -std=c99 -O3 -fopenmp -ffp-contract=off -fno-math-errno -fno-trapping-math, link with -lm. */"
    echo '#if defined(OXL_IMPLEMENTATION) && !defined(OCEANXL_IMPLEMENTATION)'
    echo '#define OCEANXL_IMPLEMENTATION'
    echo '#endif'
    echo '#if defined(OCEANXL_IMPLEMENTATION) && !defined(_WIN32) && !defined(_POSIX_C_SOURCE)'
    echo '#define _POSIX_C_SOURCE 200809L'
    echo '#endif'
    cat oceanxl.h
    echo
    echo '#if defined(OCEANXL_IMPLEMENTATION) && !defined(OCEANXL_IMPLEMENTED)'
    echo '#define OCEANXL_IMPLEMENTED'
    amalgamate ''
    echo '#endif /* OCEANXL_IMPLEMENTATION */'
} >"$out/single/oceanxl.h"
grep -n '^#include "' "$out/oceanxl.c" "$out/single/oceanxl.h" | grep -v '"oceanxl.h"' && { echo "dist.sh: an include was left" >&2; exit 1; }
wc -l "$out/oceanxl.h" "$out/oceanxl.c" "$out/single/oceanxl.h" | sed '$d'
