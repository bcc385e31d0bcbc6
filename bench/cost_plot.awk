# cost_plot.awk - awk -f bench/cost_plot.awk docs/log/cost.tsv > docs/log/cost.svg
#
# Milliseconds of a training step over what is varied, both axes logarithmic, a panel each; and the slope, by least squares.
function log10(x) { return log(x) / log(10) }
function label(x, y, anchor, s) { printf "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\">%s</text>\n", x, y, anchor, s }
function panel(p,    what, left, i, n, x, y, sx, sy, sxx, sxy, low, high, line) {
    what = name[p]; n = count[what]; left = 60 + (p - 1) * step
    low = log10(value[what, 1]); high = log10(value[what, n])
    printf "<rect x=\"%d\" y=\"%d\" width=\"%d\" height=\"%d\" fill=\"none\" stroke=\"#ccc\"/>\n", left, bottom - height, width, height
    for (i = 1; i <= n; i++) {
        x = log10(value[what, i]); y = log10(cost[what, i])
        sx += x; sy += y; sxx += x * x; sxy += x * y
        x = left + 12 + (x - low) / (high - low) * (width - 24)
        y = bottom - (y - least) / (most - least) * height
        line = line sprintf("%.1f,%.1f ", x, y)
        printf "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3.5\" fill=\"#1f4e79\"/>\n", x, y
        if (i == 1 || i == n) label(x, bottom + 18, i == 1 ? "start" : "end", value[what, i])
    }
    printf "<polyline fill=\"none\" stroke=\"#1f4e79\" stroke-width=\"1.5\" points=\"%s\"/>\n", line
    label(left + width / 2, bottom + 36, "middle", title[what])
    label(left + width / 2, bottom - height - 10, "middle", sprintf("slope %.2f", (n * sxy - sx * sy) / (n * sxx - sx * sx)))
}
BEGIN {
    FS = "\t"; width = 170; step = 195; height = 240; bottom = 310
    title["planes"] = "numbers a Gaussian (SH 0 to 3)"; title["views"] = "views that take turns"; title["threads"] = "threads (time of both together)"
}
/^#/ { where = $4; next }
{
    if (!($1 in count)) { name[++panels] = $1; if (!($1 in title)) title[$1] = $1 }
    value[$1, ++count[$1]] = $2; cost[$1, count[$1]] = $3
    if (log10($3) < least || NR < 3) least = log10($3)
    if (log10($3) > most || NR < 3) most = log10($3)
}
END {
    least -= 0.1; most += 0.1
    printf "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%d\" height=\"370\" font-family=\"sans-serif\" font-size=\"12\">\n", 60 + panels * step
    print "<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>"
    label(16, 24, "start", "Processor milliseconds of a training step, both axes logarithmic: " where)
    for (d = 1; d <= 1000; d *= 10)
        for (k = 1; k <= 5; k += k < 2 ? 1 : 3)
            if (log10(d * k) > least && log10(d * k) < most) {
                y = bottom - (log10(d * k) - least) / (most - least) * height
                printf "<line x1=\"60\" y1=\"%.1f\" x2=\"%d\" y2=\"%.1f\" stroke=\"#e4e4e4\"/>\n", y, 60 + (panels - 1) * step + width, y
                label(54, y + 4, "end", d * k)
            }
    for (p = 1; p <= panels; p++) panel(p)
    print "</svg>"
}
