#!/usr/bin/env bash
# check.sh FOLDER - the course's page: matches its sources, is small enough, and computes what the native build computes.
# Wants clang and wasm-ld for the first, Chromium for the last; says what it skips. FOLDER has numbers (make course-check).
set -u
cd "$(dirname "$0")/../.." || exit 1
page=examples/course/index.html folder=$1 failed=0
mkdir -p "$folder"

bytes=$(wc -c <"$page")
echo "index.html: $bytes bytes"
[ "$bytes" -le 300000 ] || { echo "FAIL index.html is larger than 300000 bytes"; failed=1; }
if grep -nE '(src|href)="https?:' "$page"; then echo "FAIL index.html refers to the network"; failed=1; fi

# Everything but the module and the compiler's name.
without_module() { sed -e '/id="module">/s/>[A-Za-z0-9+/=]*</></' -e '1,5s/ with .*$//' "$1"; }

if command -v "${WASM_CC:-clang}" >/dev/null && command -v wasm-ld >/dev/null; then
    if ! make -s course-page >"$folder/make.log" 2>&1; then
        tail -n 5 "$folder/make.log"
        echo 'FAIL make course-page'
        failed=1
    elif cmp -s "$folder/index.html" "$page"; then
        echo 'index.html matches its sources'
    elif [ "$(sed -n '2,3s/.* with //p' "$folder/index.html")" != "$(sed -n '2,3s/.* with //p' "$page")" ] &&
        [ "$(without_module "$folder/index.html")" = "$(without_module "$page")" ]; then
        echo 'index.html matches its sources, but for the module: another compiler made it'
    else
        echo 'FAIL index.html does not match its sources. fix: make course, and commit it'
        failed=1
    fi
else
    echo 'skipped: whether index.html matches its sources (Debian: clang, lld)'
fi

browser=$(command -v chromium || command -v chromium-browser || command -v google-chrome)
if [ -n "$browser" ]; then
    timeout 300 "$browser" --headless --no-sandbox --disable-gpu --enable-logging=stderr --virtual-time-budget=60000 --user-data-dir="$folder/profile" \
        --dump-dom "file://$PWD/$page#numbers" >"$folder/dom.html" 2>"$folder/browser.log"
    if grep CONSOLE "$folder/browser.log"; then echo 'FAIL the console has messages'; failed=1; fi
    sed -n '/<pre id="numbers">/,/<\/pre>/p' "$folder/dom.html" >"$folder/numbers.txt"
    "$folder/numbers" <"$folder/numbers.txt" || failed=1
    "$folder/numbers_libm" <"$folder/numbers.txt" || failed=1
    rm -rf "$folder/profile"
else
    echo 'skipped: the numbers in a browser (Debian: chromium)'
fi
exit $failed
