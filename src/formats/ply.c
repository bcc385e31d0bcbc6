/* ply.c - reads PLY files: any property order and type, lists, ascii and both byte orders.
 *
 * Source: Turk, "The PLY Polygon File Format" (1994), and common extensions: int8..float64 as type names, CR
 * LF, `obj_info`. Usage: ply_open reads the header, ply_read the columns of one element, ply_close.
 * Invariant: ply_open compares the header with the size of the file, so memory allocated by `rows` is at most
 * a multiple of the file size.
 */
#include "ply.h"
#include "../core/bytes.h"

static const struct ply_type_name {
    const char *name, *other;
    size_t size;
} ply_types[] = {/* in the order of enum ply_type */
                 {"char", "int8", 1},     {"uchar", "uint8", 1},   {"short", "int16", 2},
                 {"ushort", "uint16", 2}, {"int", "int32", 4},     {"uint", "uint32", 4},
                 {"float", "float32", 4}, {"double", "float64", 8}};

/* ---------------- the header */

enum { PLY_WORDS = 5 };

struct ply_header {
    oxl_context *ctx;
    struct ply *ply;
    oxl_result rc;            /* the first error; nothing is read after it */
    const char *cursor, *end; /* the rest of the file */
    const char *begin;        /* of the line */
    int line, words;
    char word[PLY_WORDS][PLY_NAME + 1]; /* first words of the line, cut */
};

/* Copies the rest of a line, printable in a message. */
static const char *ply_printable(const char *from, const char *end, char out[48])
{
    size_t n = 0;
    for (; from + n < end && n < 44 && from[n] != '\n' && from[n] != '\r'; n++)
        out[n] = from[n] >= ' ' && from[n] <= '~' ? from[n] : '?';
    out[n] = 0;
    return out;
}

static void ply_header_fail(struct ply_header *h, const char *wanted)
{
    char seen[48];
    if (h->rc == OXL_OK)
        h->rc = oxl_fail(h->ctx, OXL_ERR_INPUT,
                         "%s:%d: found '%s', expected %s\nfix: correct the header or export the file again",
                         h->ply->path, h->line, ply_printable(h->begin, h->end, seen), wanted);
}

static int ply_is(const struct ply_header *h, int word, const char *text)
{
    return word < h->words && !strcmp(h->word[word], text);
}

static void ply_next_line(struct ply_header *h)
{
    const char *newline = memchr(h->cursor, '\n', (size_t)(h->end - h->cursor));
    char line[PLY_WORDS * (PLY_NAME + 2)];
    h->line++;
    h->begin = h->cursor;
    h->cursor = newline ? newline + 1 : h->end;
    snprintf(line, sizeof line, "%.*s", (int)OXL_MIN((size_t)(h->cursor - h->begin), sizeof line - 1),
             h->begin);
    h->words =
        sscanf(line, "%64s %64s %64s %64s %64s", h->word[0], h->word[1], h->word[2], h->word[3], h->word[4]);
    if (!newline) ply_header_fail(h, "more lines: the header has no end_header");
}

static void ply_header_format(struct ply_header *h)
{
    static const char *const names[] = {"ascii", "binary_little_endian", "binary_big_endian"};
    for (int i = 0; i < 3; i++)
        if (ply_is(h, 1, names[i]) && ply_is(h, 2, "1.0")) h->ply->format = (enum ply_format)(PLY_ASCII + i);
    if (h->ply->format == PLY_NO_FORMAT)
        ply_header_fail(h, "format ascii, binary_little_endian or binary_big_endian, version 1.0");
}

static void ply_header_element(struct ply_header *h)
{
    struct ply *ply = h->ply;
    struct ply_element element = {.name = ""};
    const char *digits = h->word[2], *end = digits + strlen(digits);
    int64_t rows = 0;
    if (h->words < 3 || strlen(h->word[1]) >= PLY_NAME || !parse_int64(&digits, end, &rows) ||
        digits != end || rows < 0)
        ply_header_fail(
            h, "element NAME COUNT, the name of less than 64 letters, the count 0 to 9223372036854775807");
    if (h->rc == OXL_OK)
        h->rc = oxl_reserve(h->ctx, &ply->element, &ply->element_capacity, (size_t)ply->elements + 1,
                            sizeof element);
    if (h->rc != OXL_OK) return;
    strcpy(element.name, h->word[1]);
    element.rows = (uint64_t)rows;
    ply->element[ply->elements++] = element;
}

/* Finds the type that a word names; -1: none. */
static int ply_header_type(const struct ply_header *h, int word)
{
    int i = OXL_COUNT(ply_types) - 1;
    while (i >= 0 && !ply_is(h, word, ply_types[i].name) && !ply_is(h, word, ply_types[i].other)) i--;
    return i;
}

static void ply_header_property(struct ply_header *h)
{
    struct ply_element *element = h->ply->elements ? &h->ply->element[h->ply->elements - 1] : NULL;
    struct ply_property property = {.is_list = ply_is(h, 1, "list")};
    const int at = property.is_list ? 3 : 1, count = property.is_list ? ply_header_type(h, 2) : 0,
              type = ply_header_type(h, at);
    if (!element) ply_header_fail(h, "an element before its properties");
    if (type < 0 || count < 0 || count >= PLY_FLOAT32 || h->words < at + 2 ||
        strlen(h->word[at + 1]) >= PLY_NAME)
        ply_header_fail(h, "property TYPE NAME, or property list TYPE TYPE NAME with a whole number to "
                           "count: the types are char, uchar, short, ushort, int, uint, float and double, "
                           "the name has less than 64 letters");
    if (h->rc == OXL_OK)
        h->rc = oxl_reserve(h->ctx, &element->property, &element->capacity, (size_t)element->properties + 1,
                            sizeof property);
    if (h->rc != OXL_OK) return;
    property.type = (enum ply_type)type, property.count_type = (enum ply_type)count;
    strcpy(property.name, h->word[at + 1]);
    element->property[element->properties++] = property;
    element->row_bytes += ply_types[property.is_list ? count : type].size;
}

static int ply_blank(char c)
{
    return c == ' ' || c == '\t' || c == '\r';
}

static oxl_result ply_read_header(oxl_context *ctx, struct ply *ply)
{
    struct ply_header h = {
        .ctx = ctx, .ply = ply, .cursor = ply->file.data, .end = ply->file.data + ply->file.size};
    ply_next_line(&h);
    if (!ply_is(&h, 0, "ply")) h.rc = OXL_OK, ply_header_fail(&h, "a PLY file, whose first line is 'ply'");
    for (ply_next_line(&h); h.rc == OXL_OK && !ply_is(&h, 0, "end_header"); ply_next_line(&h)) {
        if (ply_is(&h, 0, "format")) ply_header_format(&h);
        else if (ply_is(&h, 0, "element")) ply_header_element(&h);
        else if (ply_is(&h, 0, "property")) ply_header_property(&h);
        else if (h.words > 0 && !ply_is(&h, 0, "comment") && !ply_is(&h, 0, "obj_info"))
            ply_header_fail(&h, "format, comment, element, property or end_header");
    }
    if (ply->format == PLY_NO_FORMAT) ply_header_fail(&h, "a format line before it");
    ply->data_line = h.line + 1;
    ply->data = (size_t)(h.cursor - ply->file.data);
    return h.rc;
}

/* Compares the header with the size of the file, in double, which does not overflow
 * and is exact below 2^53. */
static oxl_result ply_check_size(oxl_context *ctx, const struct ply *ply)
{
    const double there = (double)(ply->file.size - ply->data);
    double need = 0;
    for (int e = 0; e < ply->elements; e++) {
        const struct ply_element *element = &ply->element[e];
        const double row = ply->format == PLY_ASCII ? 2.0 * element->properties /* one digit and one blank */
                                                    : (double)element->row_bytes;
        need += (double)element->rows * row;
        if (need > there + (ply->format == PLY_ASCII)) /* Allows that the last line has no newline. */
            return oxl_fail(
                ctx, OXL_ERR_INPUT,
                "%s: element %s announces %llu rows, which take at least %.0f bytes; the file has %.0f\n"
                "fix: the file was cut short or its header is wrong; copy or export it again",
                ply->path, element->name, (unsigned long long)element->rows, need, there);
    }
    return OXL_OK;
}

/* ---------------- the data */

static double ply_value(const char *p, enum ply_type type, int big_endian)
{
    const size_t size = ply_types[type].size;
    unsigned char turned[8];
    uint64_t bits;
    for (size_t i = 0; i < size; i++) turned[i] = (unsigned char)p[big_endian ? size - 1 - i : i];
    if (type == PLY_FLOAT32) return bytes_float(turned);
    if (type == PLY_FLOAT64) return bytes_double(turned);
    bits = bytes_get(turned, (int)size);
    return (double)bits - (type % 2 == 0 && turned[size - 1] >> 7 ? ldexp(1, 8 * (int)size) : 0);
}

/* Reads an element's rows. target: (properties), or NULL to skip the element. */
struct ply_rows {
    oxl_context *ctx;
    const struct ply *ply;
    const struct ply_element *element;
    const struct ply_target *target;
    const char *cursor, *end;
    uint64_t row;
    oxl_result rc;
};

static void ply_fail(struct ply_rows *r, const char *wanted)
{
    char seen[48], place[64];
    int line = r->ply->data_line;
    if (r->rc != OXL_OK) return;
    for (const char *c = r->ply->file.data + r->ply->data; c < r->cursor; c++) line += *c == '\n';
    if (r->ply->format == PLY_ASCII) snprintf(place, sizeof place, "%d", line);
    else snprintf(place, sizeof place, " byte %zu", (size_t)(r->cursor - r->ply->file.data));
    r->rc = oxl_fail(
        r->ctx, OXL_ERR_INPUT,
        "%s:%s: row %llu of %llu of element %s: found '%s', expected %s\n"
        "fix: correct the line, or copy or export the file again",
        r->ply->path, place, (unsigned long long)r->row, (unsigned long long)r->element->rows,
        r->element->name,
        r->ply->format == PLY_ASCII ? ply_printable(r->cursor, r->end, seen) : "the end of the file", wanted);
}

static void ply_skip_blanks(struct ply_rows *r)
{
    while (r->cursor < r->end && ply_blank(*r->cursor)) r->cursor++;
}

/* Reads the next number, in a text from the same line. */
static double ply_number(struct ply_rows *r, enum ply_type type)
{
    double value = 0;
    if (r->ply->format != PLY_ASCII) {
        if ((size_t)(r->end - r->cursor) < ply_types[type].size) ply_fail(r, "more bytes");
        if (r->rc != OXL_OK) return 0;
        value = ply_value(r->cursor, type, r->ply->format == PLY_BIG);
        r->cursor += ply_types[type].size;
        return value;
    }
    ply_skip_blanks(r);
    if (!parse_double(&r->cursor, r->end, &value) ||
        !(r->cursor == r->end || ply_blank(*r->cursor) || *r->cursor == '\n'))
        ply_fail(r, "a number for each property");
    return value;
}

static void ply_skip_list(struct ply_rows *r, const struct ply_property *p)
{
    const double count = ply_number(r, p->count_type);
    if (!(count >= 0 && count <= (double)(r->end - r->cursor))) ply_fail(r, "a list that fits the file");
    for (size_t left = r->rc == OXL_OK ? (size_t)count : 0; left > 0 && r->rc == OXL_OK; left--)
        ply_number(r, p->type);
}

/* Reads a row. Texts have one a line, as the format requires, so an error names the row that lacks a
 * value. */
static void ply_row(struct ply_rows *r)
{
    const int is_text = r->ply->format == PLY_ASCII;
    while (is_text && r->cursor < r->end && (ply_blank(*r->cursor) || *r->cursor == '\n')) r->cursor++;
    for (int c = 0; c < r->element->properties && r->rc == OXL_OK; c++) {
        const struct ply_property *p = &r->element->property[c];
        if (p->is_list) ply_skip_list(r, p);
        else {
            const double value = ply_number(r, p->type);
            if (r->target && r->target[c].as_float) r->target[c].as_float[r->row] = (float)value;
            if (r->target && r->target[c].as_double) r->target[c].as_double[r->row] = value;
        }
    }
    if (!is_text) return;
    ply_skip_blanks(r);
    if (r->cursor < r->end && *r->cursor != '\n') ply_fail(r, "the end of the line");
}

/* ---------------- public functions */

OXL_INTERNAL oxl_result ply_open(oxl_context *ctx, const char *path, struct ply *out)
{
    oxl_result rc = OXL_OK;
    *out = (struct ply){.path = oxl_strdup(ctx, path)};
    if (!out->path) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = os_read_file(ctx, path, &out->file);
    if (rc == OXL_OK) rc = os_refuse_gzip(ctx, path, out->file.data, out->file.size);
    if (rc == OXL_OK) rc = ply_read_header(ctx, out);
    if (rc == OXL_OK) rc = ply_check_size(ctx, out);
    if (rc != OXL_OK) ply_close(ctx, out);
    return rc;
}

/* Skips the elements before the wanted one by reading them: lists have no size in advance. */
OXL_INTERNAL oxl_result ply_read(oxl_context *ctx, const struct ply *ply, int element,
                                 const struct ply_target *target)
{
    struct ply_rows r = {
        .ctx = ctx, .ply = ply, .cursor = ply->file.data + ply->data, .end = ply->file.data + ply->file.size};
    for (int e = 0; e <= element; e++) {
        r.element = &ply->element[e];
        r.target = e == element ? target : NULL;
        /* Skips rows without bytes. */
        for (r.row = 0; r.row < r.element->rows && r.element->properties && r.rc == OXL_OK; r.row++)
            ply_row(&r);
    }
    return r.rc;
}

OXL_INTERNAL double ply_white(enum ply_type type)
{
    return type == PLY_FLOAT32 || type == PLY_FLOAT64 ? 1
           : type == PLY_INT16 || type == PLY_UINT16  ? 65535
                                                      : 255;
}

OXL_INTERNAL void ply_close(oxl_context *ctx, struct ply *ply)
{
    for (int e = 0; e < ply->elements; e++) oxl_free(ctx, ply->element[e].property);
    OXL_FREE(ctx, ply->element, ply->path);
    os_release_file(ctx, &ply->file);
    *ply = (struct ply){0};
}

OXL_INTERNAL int ply_find_element(const struct ply *ply, const char *name)
{
    for (int e = 0; e < ply->elements; e++)
        if (!strcmp(ply->element[e].name, name)) return e;
    return -1;
}

OXL_INTERNAL int ply_find_property(const struct ply_element *element, const char *name)
{
    for (int c = 0; c < element->properties; c++)
        if (!element->property[c].is_list && !strcmp(element->property[c].name, name)) return c;
    return -1;
}
