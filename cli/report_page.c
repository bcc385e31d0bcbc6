/* report_page.c - writes the frame of the page: style, base64, JPEG.
 *
 * The page has one column, which fits a phone and is wider where there is room; it is light or dark as the
 * reader's system is, and black on white on paper.
 *
 * Invariant: the page asks the network for nothing, and no name from outside reaches it unescaped.
 */
#include "report.h"

enum { PAGE_QUALITY = 82 }; /* of JPEG */

/* Styles the page. Ink on its ground has a contrast of at least 7 : 1 in both themes, the pale ink 4.5 : 1
 * (WCAG 2.1, levels AAA and AA). */
static const char *const PAGE_STYLE[] = {
    ":root{--paper:#f5f8f9;--card:#fff;--ink:#14232b;--pale:#506470;--line:#d5dfe4;--sea:#0a6781;--warn:#9a4a00;--good:#1d6b3a;"
    "--s0:#0a6781;--s1:#b4530f;--s2:#5b4bb4;--s3:#2c7a3f;--s4:#a32b62;--s5:#6b6b00;color-scheme:light dark}",
    "@media(prefers-color-scheme:dark){:root{--paper:#0c1418;--card:#142026;--ink:#e6eff3;--pale:#9db2bd;--line:#2a3b44;"
    "--sea:#62c6e2;--warn:#ffb066;--good:#7fd39b;--s0:#62c6e2;--s1:#ffb066;--s2:#b3a6ff;--s3:#7fd39b;--s4:#ff94c2;--s5:#d8d860}}",
    "*{box-sizing:border-box}html{-webkit-text-size-adjust:100%}body{margin:0;background:var(--paper);color:var(--ink);"
    "font:16px/1.55 system-ui,-apple-system,'Segoe UI',Roboto,'Helvetica Neue',Arial,sans-serif}",
    "main{max-width:64rem;margin:0 auto;padding:1.2rem 1rem 3rem}h1{font-size:1.7rem;line-height:1.2;margin:.4rem 0 .2rem;"
    "overflow-wrap:anywhere}h2{font-size:1.2rem;margin:0 0 .7rem}h3{font-size:1rem;margin:1.2rem 0 .4rem}p{margin:.4rem 0 .8rem;max-width:44rem;overflow-wrap:anywhere}",
    "section{background:var(--card);border:1px solid var(--line);border-radius:.8rem;padding:1rem 1.1rem 1.1rem;margin:1rem 0}"
    ".pale,small,figcaption{color:var(--pale)}small,figcaption{font-size:.85rem}",
    ".mark{display:inline-block;border-radius:1rem;padding:.05rem .7rem;font-size:.85rem;font-weight:600;border:1.5px solid}"
    ".good{color:var(--good)}.warn{color:var(--warn)}",
    ".tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(8.6rem,1fr));gap:.7rem;margin:1rem 0}.tile{background:var(--card);"
    "border:1px solid var(--line);border-radius:.8rem;padding:.6rem .9rem}.tile b{display:block;font-size:1.45rem;line-height:1.3;"
    "font-variant-numeric:tabular-nums}.tile span{font-size:.85rem;color:var(--pale)}",
    "table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}th,td{text-align:left;padding:.3rem .5rem .3rem 0;"
    "border-bottom:1px solid var(--line);vertical-align:top}th{font-weight:600;color:var(--pale);font-size:.85rem}"
    "td.n,th.n{text-align:right}.scroll{overflow-x:auto}td.name{overflow-wrap:anywhere;min-width:9rem}",
    "dl{display:grid;grid-template-columns:1fr;gap:0;margin:0}dt{font-weight:600;padding-top:.5rem}dd{margin:0;padding-bottom:.5rem;"
    "border-bottom:1px solid var(--line);overflow-wrap:anywhere}dd small{display:block}",
    "@media(min-width:40rem){dl{grid-template-columns:13rem 1fr}dt{border-bottom:1px solid var(--line);padding:.45rem 0}dd{padding:.45rem 0}}",
    "figure{margin:0 0 1rem}img,svg{max-width:100%;height:auto;display:block}.charts{display:grid;gap:1rem;"
    "grid-template-columns:repeat(auto-fit,minmax(min(19rem,100%),1fr))}.charts figure{margin:0}",
    ".three{display:grid;grid-template-columns:repeat(auto-fit,minmax(9.5rem,1fr));gap:.5rem}.three figure{margin:0}"
    ".three img{width:100%;border-radius:.4rem}@media(max-width:34rem){.three{grid-template-columns:1fr 1fr}"
    ".three figure:last-child:nth-child(odd){grid-column:1/-1}section{padding:.9rem .8rem}th,td{font-size:.85rem;padding-right:.3rem}"
    "td.name{min-width:7rem}}",
    "pre{background:var(--paper);border:1px solid var(--line);border-radius:.5rem;"
    "padding:.7rem .8rem;overflow-x:auto;font:.85rem/1.5 ui-monospace,Menlo,Consolas,monospace;white-space:pre-wrap;overflow-wrap:anywhere}",
    "ul{padding-left:1.2rem;margin:.3rem 0}li{overflow-wrap:anywhere}summary{cursor:pointer;color:var(--sea);font-weight:600;"
    "padding:.3rem 0}a{color:var(--sea)}",
    ".chart text{fill:var(--pale);font-size:12px}.chart .grid{stroke:var(--line);stroke-width:1}"
    ".chart path{fill:none;stroke-width:1.8;stroke-linejoin:round}.many path{stroke-width:1.1;stroke-opacity:.5}"
    ".map text{fill:#fff;font-size:22px}.map circle{fill:#fff;fill-opacity:.85;stroke:#0a6781;stroke-width:1.5}"
    ".map .test{fill:#ffd24a;fill-opacity:1;stroke:#000;stroke-width:1}.map rect{fill-opacity:.55}"
    ".map path{fill:none;stroke:#fff;stroke-width:2}footer{color:var(--pale);font-size:.85rem;margin-top:1.5rem}",
    "@media print{:root{--paper:#fff;--card:#fff;--ink:#000;--pale:#444;--line:#bbb;--sea:#0a6781;color-scheme:light}body{font-size:11pt}"
    "main{max-width:none;padding:0}section{break-inside:auto;border:0;border-top:1px solid #bbb;border-radius:0;padding:.8rem 0}"
    "figure,.tile,tr{break-inside:avoid}h2,h3{break-after:avoid}details:not([open])>summary{display:none}}",
};

void page_open(struct output *t, const char *title)
{
    output_add(
        t,
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
        "<meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n<title>%S - OceanXL report</title>\n<style>\n",
        title);
    for (size_t i = 0; i < sizeof PAGE_STYLE / sizeof *PAGE_STYLE; i++) output_add(t, "%s\n", PAGE_STYLE[i]);
    output_add(t, "</style>\n</head>\n<body>\n<main>\n");
}

/* Writes a data: URI in base64 (RFC 4648, table 1). */
void page_data(struct output *t, const void *data, size_t size)
{
    static const char digit[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    const unsigned char *from = data;
    output_add(t, "data:image/jpeg;base64,");
    for (size_t i = 0; i < size; i += 3) {
        const size_t left = size - i;
        const unsigned bits = (unsigned)from[i] << 16 | (left > 1 ? (unsigned)from[i + 1] << 8 : 0) |
                              (left > 2 ? from[i + 2] : 0);
        char four[4];
        for (unsigned k = 0; k < 4; k++) four[k] = k <= left ? digit[bits >> (18 - 6 * k) & 63] : '=';
        output_bytes(t, four, 4);
    }
}

void page_jpeg(struct report *r, const oxl_image *image)
{
    char *bytes = NULL;
    size_t size = 0;
    if (oxl_image_to_jpeg(r->ctx, image, PAGE_QUALITY, &bytes, &size) == OXL_OK)
        page_data(&r->page, bytes, size);
    else r->page.failed = 1;
    oxl_text_free(r->ctx, bytes);
}
