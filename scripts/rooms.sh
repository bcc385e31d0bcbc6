#!/bin/sh
# rooms.sh [write] - the layers of src/: includes go to lower layers only, each layer has one header of at most 320 lines; line counts.
#
# Calls are covered too: `make modules` compiles each file with its own layer's header, which declares lower layers alone.
# write: puts the table between the marks in docs/ARCHITECTURE.md. Without it, the table there must be the current one.
set -eu
cd "$(dirname "$0")/.."
layers='core survey model render train blocks job'
page=docs/ARCHITECTURE.md
table=$(mktemp)
trap 'rm -f "$table" "$table.page"' EXIT

# FILE: its includes in quotes, as paths from the root.
includes() {
    sed -n 's/^#include "\([^"]*\)".*/\1/p' "$1" | while read -r name; do
        realpath -m --relative-to=. "$(dirname "$1")/$name"
    done
}

wrong=0
complain() { echo "rooms: $1" >&2; wrong=1; }

allowed=''
for layer in $layers; do
    allowed="$allowed src/$layer/"
    used=''
    for file in src/"$layer"/*.[ch]; do
        for name in $(includes "$file"); do
            folder=$(dirname "$name")/
            case " $allowed ./ " in
                *" $folder "*) [ "$folder" = "src/$layer/" ] || [ "$folder" = ./ ] || used="$used $(basename "$folder")" ;;
                *)
                    if [ "$file" = src/render/backend.c ] && [ "$folder" = backends/vulkan/ ]; then continue; fi
                    complain "$file includes $name; wanted a header of a lower layer (${allowed# })"
                    ;;
            esac
        done
    done
    header=$(wc -l <"src/$layer/$layer.h")
    [ "$header" -le 320 ] || complain "src/$layer/$layer.h has $header lines, wanted at most 320"
    files=$(ls src/"$layer"/*.c | wc -l)
    lines=$(cat src/"$layer"/*.[ch] | wc -l)
    used=$(for u in $used; do echo "$u"; done | sort -u | tr '\n' ' ' | sed 's/ $//; s/ /, /g')
    printf '| `src/%s` | %s | %s | %s | %s |\n' "$layer" "$files" "$lines" "$header" "${used:-(nothing)}" >>"$table"
done
for file in main.c cli/*.[ch] lab/*.[ch]; do
    for name in $(includes "$file"); do
        case $name in
            oceanxl.h | oceanxl_job.h | cli/* | lab/* | src/core/json.h) ;;
            *) complain "$file includes $name; wanted the public headers, and those of cli/ and lab/" ;;
        esac
    done
done

{ echo '| layer | modules | lines | its header | headers used directly |'; echo '|---|--:|--:|--:|---|'; cat "$table"; } >"$table.page"
cat "$table.page"
printf 'src/ %s lines, cli/ and lab/ %s, main.c %s, oceanxl.h %s, oceanxl_job.h %s, backends/vulkan %s, reference/splat.c %s\n' \
    "$(cat src/*/*.[ch] | wc -l)" "$(cat cli/*.[ch] lab/*.[ch] | wc -l)" "$(wc -l <main.c)" "$(wc -l <oceanxl.h)" "$(wc -l <oceanxl_job.h)" \
    "$(cat backends/vulkan/*.[ch] | wc -l)" "$(wc -l <reference/splat.c)"

between() { awk '/<!-- end -->/ { inside = 0 } inside { print } /<!-- layers -->/ { inside = 1 }' "$page"; }
if [ "${1:-}" = write ]; then
    awk -v new="$table.page" '/<!-- end -->/ { inside = 0 } !inside { print }
        /<!-- layers -->/ { inside = 1; while ((getline line < new) > 0) print line }' "$page" >"$table.new"
    cat "$table.new" >"$page"
    rm -f "$table.new"
else # line counts change daily; the layers and what they use must be right
    cut -d'|' -f2,6 "$table.page" >"$table"
    between | cut -d'|' -f2,6 | diff - "$table" >/dev/null || complain "$page shows other layers. fix: scripts/rooms.sh write"
fi
[ $wrong = 0 ] && echo 'rooms: 0 includes of higher layers'
exit $wrong
