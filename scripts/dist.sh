#!/bin/sh
# dist.sh DIR - the trainer in one header, DIR/single/oceanxl.h, and the job on top of it: DIR/oceanxl_job.c, DIR/oceanxl_job.h.
#
# Replaces each #include "..." of oceanxl.c by the text of the file, once. What is above the checks of a survey in oceanxl.c is the trainer;
# oceanxl_job.c includes the header with its implementation, and has the rest. Of the comment at the head of a .c file its first line stays,
# a system header is included once, tabs indent (six at most), nothing is aligned, and blank lines and what the tests' reference, the Vulkan backend and include guards
# need is left out: the same text in nine tenths of the size.
set -eu
cd "$(dirname "$0")/.."
out=${1:-dist}
mkdir -p "$out/single"
trainer=$out/single/oceanxl.h
job=$out/oceanxl_job.c
tabs() { # FILE
    awk '{ while ($0 ~ /^\t*    /) sub(/    /, "\t"); print }' "$1"
}
version=$(sed -n 's/^#define OXL_VERSION "\(.*\)"/\1/p' oceanxl.h)
{
    cat <<END
/* OceanXL $version in one header, made by scripts/dist.sh: do not edit.
 *
 * In exactly one C file, ahead of every other header:
 *
 *     #define OCEANXL_IMPLEMENTATION
 *     #include "oceanxl.h"
 *
 * and compile that file with -std=c99 -O3 -fopenmp -ffp-contract=off -fno-math-errno -fno-trapping-math, link with -lm. */
#if defined(OCEANXL_IMPLEMENTATION) && !defined(_WIN32) && !defined(_POSIX_C_SOURCE)
#define _POSIX_C_SOURCE 200809L
#endif
END
    tabs oceanxl.h
    printf '\n#if defined(OCEANXL_IMPLEMENTATION) && !defined(OCEANXL_IMPLEMENTED)\n#define OCEANXL_IMPLEMENTED\n'
    # The options' types; their comments are in DIR/oceanxl_job.h.
    tabs oceanxl_job.h | awk '
        { sub(/ *\/\*.*\*\//, ""); if (sub(/ *\/\*.*/, "")) inside = 1; else if (sub(/.*\*\//, "")) inside = 0; else if (inside) next }
        NF && !/^#include "oceanxl.h"/'
    # The compiler without OpenMP is not to warn of `#pragma omp`, nor of functions that the job alone uses.
    printf '#ifdef __GNUC__\n#pragma GCC diagnostic push\n#pragma GCC diagnostic ignored "-Wunknown-pragmas"\n#pragma GCC diagnostic ignored "-Wunused-function"\n#endif\n'
} >"$trainer"
{
    echo "/* OceanXL $version, the job: survey folder in, output folder out. Made by scripts/dist.sh: do not edit."
    echo " * It has the trainer in it, so a program links this file or defines OCEANXL_IMPLEMENTATION, not both. */"
    echo '#define OCEANXL_IMPLEMENTATION'
    echo '#include "single/oceanxl.h"'
} >"$job"
cp oceanxl_job.h "$out/"

awk -v trainer="$trainer" -v job="$job" '
    function folder(path) { sub(/[^\/]*$/, "", path); return path }
    function resolve(base, name) {
        name = folder(base) name
        while (sub(/[^\/.]+\/\.\.\//, "", name)) { } # a/../b is b
        return name
    }
    # Returns 0 for a line of a branch that is never compiled here, and for the directives of such a choice.
    function chosen(line) {
        if (line ~ /^#if/) choice[++depth] = line ~ /^#ifndef OXL_([A-Z_]+_H|REFERENCE)$/ ? 1 : line ~ /^#ifdef OXL_(VULKAN|REFERENCE)$/ ? -1 : 0
        else if (line ~ /^#else/ && choice[depth]) { choice[depth] = -choice[depth]; return 0 }
        else if (line ~ /^#endif/ && choice[depth--]) return 0
        for (i = 1; i <= depth; i++) if (choice[i] < 0) return 0
        return !(line ~ /^#if/ && choice[depth])
    }
    function emit(path,    line, name, got, head, file) {
        if (path in seen || path ~ /^oceanxl(_job)?\.h$/) return
        seen[path] = 1
        file = path; sub(/^src\//, "", file)
        head = 1 # 1: its first line; 2: the others; 0: what follows
        while ((got = getline line < path) > 0) {
            if (path == "oceanxl.c" && line ~ /^\/\* checks of a survey/) to = job
            if (head == 1) {
                if (line ~ /^\/\*/) sub(/[^ ]* - /, file " - ", line)
                if (path ~ /\.c$/) print line (line ~ /\*\/$/ ? "" : " */") >>to
            }
            if (head) {
                head = line ~ /\*\/$/ ? 0 : 2
                continue
            }
            while (line ~ /^\t*    /) sub(/    /, "\t", line)
            if (line ~ /^\t+ +[^ *]/) sub(/ +/, "", line)
            while (line ~ /^\t\t\t\t\t\t\t/) sub(/\t/, "", line)
            if (!chosen(line) || line ~ /^#define OXL_[A-Z_]+_H$/) continue
            sub(/ +\\$/, " \\", line)
            if (line ~ /[^ ]  +\/\*/) sub(/  +\/\*/, " /*", line)
            sub(/\/\* ----------------/, "/* --", line)
            if (line !~ /^#/) sub(/OXL_INTERNAL/, "static", line)
            if (line ~ /^#include </ && depth == 0 && path ~ /\.c$/) {
                if (line in seen) continue
                seen[line] = 1
            }
            if (line ~ /^#include "/) {
                name = line; sub(/^#include "/, "", name); sub(/".*/, "", name)
                emit(resolve(path, name))
            } else if (line != "") print line >>to
        }
        if (got < 0) { print "dist.sh: cannot read " path > "/dev/stderr"; exit 1 }
        close(path)
    }
    BEGIN { to = trainer; emit("oceanxl.c"); if (to == trainer) { print "dist.sh: oceanxl.c has no checks of a survey" > "/dev/stderr"; exit 1 } }'
printf '#ifdef __GNUC__\n#pragma GCC diagnostic pop\n#endif\n#endif /* OCEANXL_IMPLEMENTATION */\n' >>"$trainer"
grep -n '^#include "' "$trainer" && { echo "dist.sh: an include was left" >&2; exit 1; }
wc -c "$trainer" "$job" | sed '$d'
