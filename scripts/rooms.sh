#!/bin/sh
# rooms.sh [write | links FOLDER] - the layers of src/: includes go to lower layers only; what is behind oceanxl.h is in the trainer's layers and has a
# limit of lines; a header that another layer includes has at most
# 370 lines, and so have the headers of its layer that it brings with it, together. Line counts are printed, and exemptions: the public headers, which every layer may include, and the backend.
#
# write: puts the table between the marks in docs/ARCHITECTURE.md, and files that are missing in oceanxl.c there. Without it, both must be current.
# links: in the objects of a build, no file calls a function of a higher layer, and no files call each other in a cycle; checks, large and
# job call at most so many inner functions of the trainer.
# Two functions of src/parts/table.c are exempt: through them lower layers read the table of parts, as data.
set -eu
cd "$(dirname "$0")/.."
layers='core survey model formats render evaluate train parts checks large job'
trainer='core survey model render evaluate train parts' # behind oceanxl.h, with formats, whose files are a row of a table each
most_code=17000                                          # lines of code of these, without comments and blanks
most_inner=90                                            # functions of these, and not of oceanxl.h, that the job calls
page=docs/ARCHITECTURE.md
table=$(mktemp)
trap 'rm -f "$table" "$table.page"' EXIT

# FILE: its includes in quotes, as paths from the root.
includes() {
    sed -n 's/^#include "\([^"]*\)".*/\1/p' "$1" | while read -r name; do
        realpath -m --relative-to=. "$(dirname "$1")/$name"
    done
}

# FILE: the headers of its own layer that it includes, directly or not.
brings() {
    todo=$1
    brought=''
    while [ "$todo" ]; do
        next=''
        for header in $todo; do
            for name in $(includes "$header"); do
                [ "$(dirname "$name")" = "$(dirname "$1")" ] || continue
                case " $1 $brought " in *" $name "*) ;; *) brought="$brought $name" next="$next $name" ;; esac
            done
        done
        todo=$next
    done
    echo "$brought"
}

if [ "${1:-}" = links ]; then
    objects=$(ls src/*/*.c | sed "s|^\(.*\)c$|$2/\1o|")
    nm -A $objects | sed "s|^$2/||" | awk '
        { split($1, part, ":") }
        $NF ~ /^parts_(at|option)$/ { next }
        $(NF - 1) == "U" { user[++uses] = part[1]; name[uses] = $NF }
        $(NF - 1) ~ /^[TDBRC]$/ { home[$NF] = part[1] }
        END { for (i = 1; i <= uses; i++) if (name[i] in home) print user[i], home[name[i]] }' | tsort >/dev/null ||
        { echo "rooms: files of src/ call each other in a cycle, above" >&2; exit 1; }
    nm -A $objects | sed "s|^$2/||" | awk -v layers="$layers" -v most_inner=$most_inner '
        { split($1, part, ":"); file = part[1] }
        $NF ~ /^parts_(at|option)$/ { next }
        $(NF - 1) == "U" { user[++uses] = file; name[uses] = $NF }
        $(NF - 1) ~ /^[TDBRC]$/ { home[$NF] = file }
        function rank(file) { split(file, part, "/"); return index(layers, part[2]) }
        END {
            for (i = 1; i <= uses; i++)
                if (name[i] in home && rank(home[name[i]]) > rank(user[i])) {
                    printf "rooms: %s calls %s in %s, a higher layer\n", user[i], name[i], home[name[i]]
                    wrong = 1
                }
            if (!wrong) print "rooms: 0 calls into higher layers"
            for (i = 1; i <= uses; i++) {
                split(user[i], from, "/")
                split(home[name[i]], to, "/")
                if (from[2] ~ /^(checks|large|job)$/ && to[2] ~ /^(survey|model|render|evaluate|train|parts)$/ && name[i] !~ /^oxl_/)
                    inner[name[i]] = to[2]
            }
            for (n in inner) { inners++; of[inner[n]]++ }
            printf "rooms: checks, large and job call %d functions of the trainer that oceanxl.h does not have (core, which all share, left out):", inners
            for (layer in of) printf " %s %d", layer, of[layer]
            print ""
            if (inners > most_inner) {
                printf "rooms: wanted at most %d: a function of oceanxl.h, or a step of the job behind one call\n", most_inner
                wrong = 1
            }
            exit wrong
        }'
    exit
fi

wrong=0
counts=''
complain() { echo "rooms: $1" >&2; wrong=1; }

limit=370 # lines of a header that other layers include, of 110 columns
allowed=''
seen=''   # such headers
device='' # of them, those that the backend includes: it is a renderer itself
exempt=''
for layer in $layers; do
    allowed="$allowed src/$layer/"
    used=''
    for file in src/"$layer"/*.[ch]; do
        for name in $(includes "$file"); do
            folder=$(dirname "$name")/
            [ "$folder" = "src/$layer/" ] || seen="$seen $name"
            [ "$folder" != ./ ] || exempt="$exempt${exempt:+, }$file -> $name"
            case " $allowed ./ " in
                *" $folder "*) [ "$folder" = "src/$layer/" ] || [ "$folder" = ./ ] || used="$used $(basename "$folder")" ;;
                *)
                    if [ "$file" = src/render/backend.c ] && [ "$folder" = backends/vulkan/ ]; then
                        exempt="$exempt${exempt:+, }$file -> $name"
                        continue
                    fi
                    complain "$file includes $name; wanted a header of a lower layer (${allowed# })"
                    ;;
            esac
        done
    done
    files=$(ls src/"$layer"/*.c | wc -l)
    lines=$(cat src/"$layer"/*.[ch] | wc -l)
    used=$(for u in $used; do echo "$u"; done | sort -u | tr '\n' ' ' | sed 's/ $//; s/ /, /g')
    content=$(sed -n '1s/^[^-]* - \([^.]*\)\..*/\1/p' "src/$layer/$layer.h") # the header's first sentence
    counts="$counts$layer $lines lines in $files modules, "
    printf '| `src/%s` | %s | %s |\n' "$layer" "$content" "${used:-(nothing)}" >>"$table"
done
for file in main.c cli/*.[ch] tools/*.[ch] lab/*.[ch] backends/vulkan/*.[ch]; do
    for name in $(includes "$file"); do
        case $name in src/*) seen="$seen $name" ;; esac
        case $file in backends/*) device="$device $name"; continue ;; esac
        case $name in
            lab/*) case $file in lab/*) ;; *) complain "$file includes $name; lab/ is a program of its own" ;; esac ;;
            oceanxl.h | oceanxl_job.h | cli/* | tools/* | src/formats/json.h | src/core/eigen.h | src/core/random.h) ;;
            *) complain "$file includes $name; wanted the public headers, json.h of src/formats, eigen.h and random.h of src/core, and those of cli/, tools/ and lab/" ;;
        esac
    done
done
most=0 # lines that a header brings with it
mostly=''
for name in $(for name in $seen; do echo "$name"; done | sort -u); do
    case $name in
        src/*)
            lines=$(wc -l <"$name")
            [ "$lines" -le $limit ] || complain "$name, which other layers include, has $lines lines; wanted at most $limit"
            case " $device " in *" $name "*) continue ;; esac
            brought=$(brings "$name")
            lines=$(cat /dev/null $brought | wc -l)
            [ "$lines" -le $limit ] || complain "$name brings $lines lines of its layer with it:$brought; wanted at most $limit"
            [ "$lines" -le "$most" ] || most=$lines mostly="$name:$brought"
            ;;
        *) exempt="$exempt, $name of $(wc -l <"$name") lines" ;;
    esac
done

{ echo '| layer | content | headers used |'; echo '|---|---|---|'; cat "$table"; } >"$table.page"
cat "$table.page"
echo "rooms: ${counts%, }"
printf 'src/ %s lines, cli/ and lab/ %s, main.c %s, oceanxl.h %s, oceanxl_job.h %s, backends/vulkan %s, reference/splat.c %s\n' \
    "$(cat src/*/*.[ch] | wc -l)" "$(cat cli/*.[ch] tools/*.[ch] lab/*.[ch] | wc -l)" "$(wc -l <main.c)" "$(wc -l <oceanxl.h)" "$(wc -l <oceanxl_job.h)" \
    "$(cat backends/vulkan/*.[ch] | wc -l)" "$(wc -l <reference/splat.c)"

# Lines of code in files: without comments and blanks.
code() {
    cat "$@" | awk '
        {
            line = $0
            kept = ""
            while (line != "") {
                if (inside) {
                    at = index(line, "*/")
                    if (!at) { line = ""; break }
                    line = substr(line, at + 2)
                    inside = 0
                } else if (match(line, /"([^"\\]|\\.)*"|\/\*/)) {
                    word = substr(line, RSTART, RLENGTH)
                    inside = word == "/*"
                    kept = kept substr(line, 1, RSTART - 1) (inside ? "" : word)
                    line = substr(line, RSTART + RLENGTH)
                } else {
                    kept = kept line
                    line = ""
                }
            }
            if (kept ~ /[^ \t]/) n++
        }
        END { print n + 0 }'
}
behind=$(for layer in $trainer; do ls src/"$layer"/*.[ch]; done | grep -v os_windows) # one of the two ports of os.h
lines=$(code $behind)
echo "rooms: behind oceanxl.h: $lines lines of code ($trainer), $(cat $behind | wc -l) with comments and blanks; $(code src/formats/*.[ch]) more in src/formats"
[ "$lines" -le $most_code ] || complain "$lines lines of code behind oceanxl.h; wanted at most $most_code"
for name in $(sed -n 's/^OXL_API .*\(oxl_[a-z0-9_]*\)(.*/\1/p' oceanxl.h | sort -u); do
    grep -qE "^([a-z].*[ *])?$name\(" $behind src/formats/*.c || complain "$name of oceanxl.h is not in: $trainer formats"
done

between() { awk '/<!-- end -->/ { inside = 0 } inside { print } /<!-- layers -->/ { inside = 1 }' "$page"; }
if [ "${1:-}" = write ]; then
    awk -v new="$table.page" '/<!-- end -->/ { inside = 0 } !inside { print }
        /<!-- layers -->/ { inside = 1; while ((getline line < new) > 0) print line }' "$page" >"$table.new"
    cat "$table.new" >"$page"
    rm -f "$table.new"
else
    between | diff - "$table.page" >/dev/null || complain "$page shows other layers. fix: scripts/rooms.sh write"
fi
# The single unit is all of src/: a part that is missing there is an empty row, and builds.
for file in src/*/*.c; do
    grep -qF "\"$file\"" oceanxl.c && continue
    if [ "${1:-}" = write ]; then # before the last file of its folder, with its own first words
        said=$(sed -n '1{s/^[^-]* - //;s/[:;].*//;s/\. .*//;s/\.$//;p;}' "$file")
        awk -v line="#include \"$file\" /* $said */" -v folder="#include \"$(dirname "$file")/" '
            NR == FNR { if (index($0, folder) == 1 && /\.c"/) last = FNR; next }
            FNR == last { print line }
            { print }' oceanxl.c oceanxl.c >"$table.page"
        cat "$table.page" >oceanxl.c
    else complain "oceanxl.c does not include $file. fix: scripts/rooms.sh write"
    fi
done
for file in backends/vulkan/*.c; do
    [ "$(wc -l <"$file")" -le 450 ] || complain "$file has $(wc -l <"$file") lines; wanted at most 450"
done
# The map, the derivations and the paper's table name functions of today.
for name in $(grep -oh '`[a-z][a-z0-9]*_[a-z0-9_]*`' docs/ARCHITECTURE.md docs/METHOD.md README.md | tr -d '`' | sort -u); do
    grep -rqw "$name" src tests reference cli tools lab oceanxl.h oceanxl_job.h || complain "the documents name $name, which is nowhere in the code"
done
echo "rooms: most lines that a header brings with it: $most, $mostly"
echo "rooms: exempt: $exempt"
[ $wrong = 0 ] && echo 'rooms: 0 includes of higher layers'
exit $wrong
