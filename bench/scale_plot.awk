# scale_plot.awk - awk -f bench/scale_plot.awk docs/log/scale.tsv > docs/log/scale.svg
#
# CPU seconds and peak memory of `oceanxl partition` over the points of the survey, both axes logarithmic, a line for each wanted
# number of blocks. The legend has the slope between the two largest surveys.
function log10(x) { return log(x) / log(10) }
function text(x, y, anchor, s) { printf "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\">%s</text>\n", x, y, anchor, s }
function slope(which, b) { # between the two largest surveys: below, what costs the same for all weighs in
    return log10(value[which, b, size[sizes]] / value[which, b, size[sizes - 1]]) / log10(size[sizes] / size[sizes - 1])
}
function panel(which, left, low, high, title, unit,    b, i, k, x, y, d) {
    text(left + width / 2, 20, "middle", title)
    for (d = low; d <= high; d++) {
        y = bottom - (d - low) / (high - low) * height
        printf "<line x1=\"%d\" y1=\"%.1f\" x2=\"%d\" y2=\"%.1f\" stroke=\"#ddd\"/>\n", left, y, left + width, y
        text(left - 6, y + 4, "end", "10<tspan dy=\"-5\" font-size=\"9\">" d "</tspan>")
    }
    for (i = 1; i <= sizes; i++) {
        x = left + (log10(size[i]) - log10(size[1])) / (log10(size[sizes]) - log10(size[1])) * width
        printf "<line x1=\"%.1f\" y1=\"%d\" x2=\"%.1f\" y2=\"%d\" stroke=\"#ddd\"/>\n", x, bottom - height, x, bottom
        text(x, bottom + 18, "middle", "10<tspan dy=\"-5\" font-size=\"9\">" sprintf("%.0f", log10(size[i])) "</tspan>")
    }
    text(left + width / 2, bottom + 36, "middle", "points")
    text(left - 40, bottom - height - 8, "start", unit)
    for (k = 1; k <= 3; k++) {
        b = shown[k]
        printf "<polyline fill=\"none\" stroke=\"%s\" stroke-width=\"2\" points=\"", colour[k]
        for (i = 1; i <= sizes; i++)
            if ((which, b, size[i]) in value) {
                x = left + (log10(size[i]) - log10(size[1])) / (log10(size[sizes]) - log10(size[1])) * width
                printf "%.1f,%.1f ", x, bottom - (log10(value[which, b, size[i]]) - low) / (high - low) * height
            }
        print "\"/>"
        printf "<text x=\"%d\" y=\"%d\" fill=\"%s\">%d block%s: slope %.2f</text>\n", left + 12, bottom - height + 18 * k, colour[k],
            b, b == 1 ? "" : "s", slope(which, b)
    }
}
BEGIN {
    FS = "\t"; width = 320; height = 260; bottom = 310
    split("1 16 64", shown, " "); split("#1f4e79 #c0504d #4f8f3f", colour, " ")
}
$1 == "partition" {
    if (!($2 in known)) { known[$2] = 1; size[++sizes] = $2; row = 0 }
    wanted = ++row <= 4 ? 4 ^ (row - 1) : 0 # the order of bench/scale.sh
    value["cpu", wanted, $2] = $8 + $9; value["peak", wanted, $2] = $10
}
END {
    print "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"860\" height=\"360\" font-family=\"sans-serif\" font-size=\"12\">"
    print "<rect width=\"860\" height=\"360\" fill=\"white\"/>"
    panel("cpu", 70, -2, 3, "oceanxl partition: processor time", "s")
    panel("peak", 500, 0, 4, "oceanxl partition: peak memory", "MB")
    print "</svg>"
}
