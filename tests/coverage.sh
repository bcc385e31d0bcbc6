#!/usr/bin/env bash
# tests/coverage.sh [WORDS...] - lines and branches of each module that the library's tests reach (gcov). With WORDS, those tests alone.
set -u
cd "$(dirname "$0")/.." || exit 1
build=build/coverage
export OMP_NUM_THREADS=1 OMP_WAIT_POLICY=passive
make -j1 BUILD=$build CFLAGS='-O0 -g -DOXL_NO_SIMD --coverage' $build/test >$build.log 2>&1 || { tail -n 20 $build.log; exit 1; }
find $build -name '*.gcda' -delete
tests/share.sh $build/test "$@" >$build/test.log
tail -n 1 $build/test.log
(cd $build && for file in src/*/*.gcno; do gcov -b -o "$(dirname "$file")" "$file" 2>/dev/null; done) | awk '
    /^File / { name = $2; gsub(/\047/, "", name); sub(/.*\/src\//, "src/", name); ours = name ~ /^src\// }
    ours && /^Branches executed/ { split($0, part, /[:% ]+/); split($0, of, " of "); branch_hit[name] += part[3] * of[2] / 100; branches[name] += of[2] }
    /^Creating/ { ours = 0 } # the sum of all files comes last, without a name
    ours && /^Lines executed/ { split($0, part, /[:% ]+/); lines = part[3]; split($0, of, " of "); count = of[2]
        seen[name] = 1; hit[name] += lines * count / 100; all[name] += count }
    END { for (n in seen) { printf "%-28s %5d lines %6.1f %%   branches %6.1f %%\n", n, all[n], 100 * hit[n] / all[n],
            branches[n] ? 100 * branch_hit[n] / branches[n] : 100; h += hit[n]; a += all[n]; bh += branch_hit[n]; b += branches[n] }
          printf "~all of src/                 %5d lines %6.1f %%   branches %6.1f %%\n", a, 100 * h / a, 100 * bh / b }' | sort | sed 's/^~/ /'
