/* svg.h - writes elements of SVG drawings as text, for %s in a format. The library and the program use it.
 *
 * Lengths are px, written with at most one decimal, independent of the locale; `look` is further attributes,
 * as class='grid'. The macros make temporaries of the enclosing block.
 */
#ifndef OXL_SVG_H
#define OXL_SVG_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { SVG_ROOM = 320, SVG_PX = 24 };
/* Bounds coordinates (px): farther ones, and nan, are written as this, where nothing is visible. */
#define SVG_FARTHEST 1e8

static inline const char *svg_px(char out[SVG_PX], double px)
{
    const long tenths = (long)floor(10 * fmin(fmax(px, -SVG_FARTHEST), SVG_FARTHEST) + 0.5);
    const long whole = labs(tenths) / 10, rest = labs(tenths) % 10;
    snprintf(out, SVG_PX, rest ? "%s%ld.%ld" : "%s%ld", tenths < 0 ? "-" : "", whole, rest);
    return out;
}
#define PX(px) svg_px((char[SVG_PX]){0}, px)

static inline const char *svg_open(char out[SVG_ROOM], double wide, double tall, const char *look)
{
    snprintf(
        out, SVG_ROOM,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%s\" height=\"%s\" viewBox=\"0 0 %s %s\" %s>\n",
        PX(wide), PX(tall), PX(wide), PX(tall), look);
    return out;
}
#define SVG_OPEN(wide, tall, look) svg_open((char[SVG_ROOM]){0}, wide, tall, look)

static inline const char *svg_line(char out[SVG_ROOM], double x0, double y0, double x1, double y1,
                                   const char *look)
{
    snprintf(out, SVG_ROOM, "<line x1=\"%s\" y1=\"%s\" x2=\"%s\" y2=\"%s\" %s/>\n", PX(x0), PX(y0), PX(x1),
             PX(y1), look);
    return out;
}
#define SVG_LINE(x0, y0, x1, y1, look) svg_line((char[SVG_ROOM]){0}, x0, y0, x1, y1, look)

static inline const char *svg_rectangle(char out[SVG_ROOM], double x, double y, double wide, double tall,
                                        const char *look)
{
    snprintf(out, SVG_ROOM, "<rect x=\"%s\" y=\"%s\" width=\"%s\" height=\"%s\" %s/>\n", PX(x), PX(y),
             PX(fmax(wide, 0)), PX(fmax(tall, 0)), look);
    return out;
}
#define SVG_RECTANGLE(x, y, wide, tall, look) svg_rectangle((char[SVG_ROOM]){0}, x, y, wide, tall, look)

/* Opens a circle, so that it can hold a title; </circle> closes it. */
static inline const char *svg_circle(char out[SVG_ROOM], double x, double y, double radius, const char *look)
{
    snprintf(out, SVG_ROOM, "<circle cx=\"%s\" cy=\"%s\" r=\"%s\" %s>", PX(x), PX(y), PX(radius), look);
    return out;
}
#define SVG_CIRCLE(x, y, radius, look) svg_circle((char[SVG_ROOM]){0}, x, y, radius, look)

/* Opens a text; escaped words and </text> follow. (x, y): the left end of the base line, or the place
 * where `look` anchors it. */
static inline const char *svg_text(char out[SVG_ROOM], double x, double y, const char *look)
{
    snprintf(out, SVG_ROOM, "<text x=\"%s\" y=\"%s\" %s>", PX(x), PX(y), look);
    return out;
}
#define SVG_TEXT(x, y, look) svg_text((char[SVG_ROOM]){0}, x, y, look)

/* Chooses the length of a scale bar: the largest of 1, 2 and 5 times the powers of ten
 * that is not above `most`. */
static inline double svg_scale_bar(double most)
{
    /* powers of ten, whose quotients are the doubles next to 0.1, 0.02 and so on */
    double above = 1, below = 1;
    if (!(most > 1e-20 && most < 1e20)) return 1;
    while (1 / below > most) below *= 10;
    while (10 * above <= most) above *= 10;
    return (5 * above / below <= most ? 5 : 2 * above / below <= most ? 2 : 1) * above / below;
}

#endif
