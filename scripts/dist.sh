#!/bin/sh
# dist.sh DIR - the library as DIR/oceanxl.c with its headers DIR/oceanxl.h, DIR/oceanxl_job.h, and as one header, DIR/single/oceanxl.h.
#
# Replaces each #include "..." of oceanxl.c by the text of the file, once. With the single header, one C file
# defines OCEANXL_IMPLEMENTATION before it includes it, ahead of all other headers.
set -eu
cd "$(dirname "$0")/.."
out=${1:-dist}
mkdir -p "$out/single"

# emit(file): its text, with #include "..." replaced by the text of that file the first time and by nothing later.
# api: what replaces the first #include of a public header: "include", that line; empty, nothing.
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
        if (path ~ /^oceanxl(_job)?\.h$/) { if (api != "") print "#include \"" path "\""; return }
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

# The implementation, whose `#pragma omp` a compiler without OpenMP is not to warn of.
implementation() {
    printf '#ifdef __GNUC__\n#pragma GCC diagnostic push\n#pragma GCC diagnostic ignored "-Wunknown-pragmas"\n#endif\n'
    amalgamate "$1"
    printf '#ifdef __GNUC__\n#pragma GCC diagnostic pop\n#endif\n'
}

version=$(sed -n 's/^#define OXL_VERSION "\(.*\)"/\1/p' oceanxl.h)
{
    echo "/* OceanXL $version, amalgamated from its modules by scripts/dist.sh: do not edit. */"
    implementation include
} >"$out/oceanxl.c"
cp oceanxl.h oceanxl_job.h "$out/"
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
    grep -v '^#include "oceanxl.h"' oceanxl_job.h
    echo
    echo '#if defined(OCEANXL_IMPLEMENTATION) && !defined(OCEANXL_IMPLEMENTED)'
    echo '#define OCEANXL_IMPLEMENTED'
    implementation ''
    echo '#endif /* OCEANXL_IMPLEMENTATION */'
} >"$out/single/oceanxl.h"
grep -n '^#include "' "$out/oceanxl.c" "$out/single/oceanxl.h" | grep -vE '"oceanxl(_job)?\.h"' && { echo "dist.sh: an include was left" >&2; exit 1; }
wc -l "$out/oceanxl.h" "$out/oceanxl.c" "$out/single/oceanxl.h" | sed '$d'
