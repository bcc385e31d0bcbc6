# speed_plot.awk - awk -v commit=COMMIT -f bench/speed_plot.awk OUT/results.csv others.csv > speed.svg
#
# Held-out PSNR over CPU seconds, from the table of `oceanxl results` (its rows that differ in iterations alone, a line a survey, the mean of the
# seeds) and from lines of NAME,CPU_SECONDS,PSNR of other programs, a point each.
function log10(x) { return log(x) / log(10) }
function at_x(seconds) { return 46 + 360 * (log10(seconds) - first) / (last - first) }
function at_y(psnr) { return 182 - 170 * (psnr - low) / (high - low) }
function label(x, y, anchor, s) { printf "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\">%s</text>\n", x, y, anchor, s }
function add(curve, row, seconds, psnr) {
    if (!(seconds > 0) || psnr == "nan") return
    if (!(curve in rows)) { name[++curves] = curve; rows[curve] = 0 }
    if (!((curve, row) in seeds)) order[curve, ++rows[curve]] = row
    seeds[curve, row]++; sum_x[curve, row] += seconds; sum_y[curve, row] += psnr
}
function draw(k, color,    curve, i, j, n, x, y, keep, line, end) {
    curve = name[k]; n = rows[curve]
    for (i = 1; i <= n; i++) {
        x[i] = sum_x[curve, order[curve, i]] / seeds[curve, order[curve, i]]
        y[i] = sum_y[curve, order[curve, i]] / seeds[curve, order[curve, i]]
        for (j = i; j > 1 && x[j - 1] > x[j]; j--) {
            keep = x[j]; x[j] = x[j - 1]; x[j - 1] = keep
            keep = y[j]; y[j] = y[j - 1]; y[j - 1] = keep
        }
    }
    for (i = 1; i <= n; i++) line = line sprintf("%s%.1f %.1f", i > 1 ? "L" : "M", at_x(x[i]), at_y(y[i]))
    printf "<path stroke=\"%s\" d=\"%s\"><title>%s</title></path>\n", color, line, curve
    printf "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3\" fill=\"%s\"/>\n", at_x(x[n]), at_y(y[n]), color
    end = at_x(x[n]) > 120
    label(at_x(x[n]) + (end ? 0 : 5), at_y(y[n]) + (end ? -6 : 3), end ? "end" : "start", curve)
}
BEGIN { FS = ","; split("#1f6fb4 #d1495b #2e933c #8d5a97 #b8860b #444", colors, " ") }
$1 == "tradeoff" && ($3 == "base" || $3 ~ /^iterations-/) { add($2, $3, $13, $6) }
NF == 3 && !/^#/ { add($1, $1, $2, $3) }
END {
    for (key in seeds) {
        seconds = log10(sum_x[key] / seeds[key]); psnr = sum_y[key] / seeds[key]
        if (!any || seconds < first) first = seconds
        if (!any || seconds > last) last = seconds
        if (!any || psnr < low) low = psnr
        if (!any || psnr > high) high = psnr
        any = 1
    }
    first = int(first + 10) - 10; last = int(last + 10) - 9; low = 5 * int(low / 5); high = 5 * int(high / 5 + 1)
    print "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 420 210\" width=\"840\" height=\"420\" role=\"img\" " \
        "aria-label=\"Held-out PSNR in dB against CPU seconds\">"
    print "<style>svg{background:#fff}text{font:9px sans-serif}path{fill:none;stroke-width:1.5}.grid{stroke:#ddd;stroke-width:.7}</style>"
    label(50, 9, "start", "Held-out PSNR, dB, against CPU seconds (commit " commit ")")
    for (y = low; y <= high; y += 5) {
        printf "<path class=\"grid\" d=\"M46 %.1fH406\"/>\n", at_y(y)
        label(40, at_y(y) + 4, "end", y)
    }
    for (d = first; d <= last; d++) label(at_x(10 ^ d), 202, "middle", 10 ^ d)
    for (k = 1; k <= curves; k++) draw(k, colors[(k - 1) % 6 + 1])
    print "</svg>"
}
