#!/bin/sh
# words.sh - the documents have a length, in words by `wc -w`, and their links lead somewhere. README's prose has few numbers.
# docs/results is the output of `oceanxl results`, and is not counted.
set -u
cd "$(dirname "$0")/.." || exit 1
export LC_ALL=C
wrong=0
complain() { echo "$*"; wrong=1; }
at_most() { # LIMIT WHAT FILE...
    limit=$1 what=$2
    shift 2
    words=$(cat "$@" | wc -w)
    echo "words: $what $words of at most $limit"
    [ "$words" -le "$limit" ] || complain "$what: $words words, wanted at most $limit"
}
at_most 700 README.md README.md
at_most 14000 docs docs/*.md
at_most 9000 docs/log docs/log/*.md
at_most 400 CHANGELOG.md CHANGELOG.md
[ "$(ls docs/*.md | wc -l)" -le 8 ] || complain "docs: $(ls docs/*.md | wc -l) files, wanted at most 8"

# Entries of the log: one line each, at most 60 words.
awk '/^- / && NF > 60 { print FILENAME ":" FNR ": an entry of " NF " words, wanted at most 60"; bad = 1 } END { exit bad }' docs/log/*.md || wrong=1

# Prose is what is outside of code, tables and the targets of links.
awk '/^```/ { code = !code; next } code || /^[|!<]/ { next }
    { gsub(/`[^`]*`/, "code"); gsub(/\]\([^)]*\)/, "]"); for (i = 1; i <= NF; i++) { words++; numbers += $i ~ /[0-9]/ } }
    END { printf "words: README has %.1f numbers per 100 words of prose, of at most 5\n", 100 * numbers / words; exit numbers * 20 > words }' README.md ||
    complain 'README.md: too many numbers; put them into a table or a plot'

# Each link to a file leads to one, and each document that a comment names is there.
for page in README.md CONTRIBUTING.md CHANGELOG.md docs/*.md docs/log/*.md examples/course/README.md; do
    for link in $(grep -v '^    ' "$page" | grep -oE '\]\([^)#: ]+' | cut -c3-); do
        case $link in http*) continue ;; esac
        [ -e "$(dirname "$page")/$link" ] || complain "$page: the link $link leads nowhere"
    done
done
for name in $(grep -rohE 'docs/[A-Za-z/]+\.md' src backends cli lab main.c oceanxl.h oceanxl_job.h tests bench scripts Makefile .ci examples/*.c examples/course | sort -u); do
    [ -e "$name" ] || complain "$name, which a comment names, is not there"
done
exit $wrong
