/* ply.c - reads PLY files: any property order and type, lists, ascii and both byte orders.
 *
 * Source: Turk, "The PLY Polygon File Format" (1994), and common extensions: int8..float64 as type names, CR
 * LF, `obj_info`. Usage: ply_open reads the header, ply_read the columns of one element, ply_close.
 * Invariant: ply_open compares the header with the size of the file, so memory allocated by `rows` is at most
 * a multiple of the file size.
 */
#include "ply.h"

static const struct ply_type_name {
    const char *name;
    enum ply_type type;
} ply_type_names[] = {
    {"char", PLY_INT8},     {"int8", PLY_INT8},       {"uchar", PLY_UINT8},    {"uint8", PLY_UINT8},
    {"short", PLY_INT16},   {"int16", PLY_INT16},     {"ushort", PLY_UINT16},  {"uint16", PLY_UINT16},
    {"int", PLY_INT32},     {"int32", PLY_INT32},     {"uint", PLY_UINT32},    {"uint32", PLY_UINT32},
    {"float", PLY_FLOAT32}, {"float32", PLY_FLOAT32}, {"double", PLY_FLOAT64}, {"float64", PLY_FLOAT64},
};

static size_t ply_size(enum ply_type type)
{
    static const uint8_t size[] = {1, 1, 2, 2, 4, 4, 4, 8}; /* in the order of enum ply_type */
    return size[type];
}

/* ---------------- the header */

struct ply_header {
    oxl_context *ctx;
    struct ply *ply;
    oxl_result rc;            /* the first error; nothing is read after it */
    const char *cursor, *end; /* the rest of the file */
    const char *line_start, *line_end;
    int line;
    const char *word[6]; /* first words of the line */
    size_t length[6];
    int words;
};

static int ply_blank(char c)
{
    return c == ' ' || c == '\t' || c == '\r';
}

static int ply_is(const struct ply_header *h, int word, const char *text)
{
    return word < h->words && strlen(text) == h->length[word] &&
           !memcmp(text, h->word[word], h->length[word]);
}

/* Copies bytes of a file, printable in a message. */
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
    if (h->rc != OXL_OK) return;
    h->rc = oxl_fail(h->ctx, OXL_ERR_INPUT,
                     "%s:%d: found '%s', expected %s\nfix: correct the header or export the file again",
                     h->ply->path, h->line, ply_printable(h->line_start, h->line_end, seen), wanted);
}

static void ply_next_line(struct ply_header *h)
{
    const char *newline = memchr(h->cursor, '\n', (size_t)(h->end - h->cursor)), *c = h->cursor;
    h->line++;
    h->line_start = h->cursor;
    h->line_end = newline ? newline : h->end;
    h->words = 0;
    if (!newline) ply_header_fail(h, "more lines: the header has no end_header");
    while (newline && h->words < 6) {
        while (c < newline && ply_blank(*c)) c++;
        if (c == newline) break;
        h->word[h->words] = c;
        while (c < newline && !ply_blank(*c)) c++;
        h->length[h->words] = (size_t)(c - h->word[h->words]);
        h->words++;
    }
    h->cursor = h->line_end + (newline != NULL);
}

static void ply_header_format(struct ply_header *h)
{
    static const char *const names[] = {"ascii", "binary_little_endian", "binary_big_endian"};
    for (int i = 0; i < 3; i++)
        if (ply_is(h, 1, names[i])) h->ply->format = (enum ply_format)(PLY_ASCII + i);
    if (h->ply->format == PLY_NO_FORMAT)
        ply_header_fail(h, "format ascii, binary_little_endian or binary_big_endian");
    if (!ply_is(h, 2, "1.0")) ply_header_fail(h, "version 1.0");
}

static void ply_header_name(struct ply_header *h, int word, char name[PLY_NAME])
{
    if (word >= h->words) ply_header_fail(h, "a name");
    else if (h->length[word] >= PLY_NAME) ply_header_fail(h, "a name of less than 64 letters");
    else snprintf(name, PLY_NAME, "%.*s", (int)h->length[word], h->word[word]);
}

static void ply_header_element(struct ply_header *h)
{
    struct ply *ply = h->ply;
    struct ply_element element = {.name = ""};
    const char *digits = h->words > 2 ? h->word[2] : NULL, *end = digits ? digits + h->length[2] : NULL;
    int64_t rows = 0;
    ply_header_name(h, 1, element.name);
    if (!digits) ply_header_fail(h, "element NAME COUNT");
    else if (!parse_int64(&digits, end, &rows) || digits != end || rows < 0)
        ply_header_fail(h, "a count of rows, 0 to 9223372036854775807");
    element.rows = (uint64_t)rows;
    if (h->rc == OXL_OK)
        h->rc = oxl_reserve(h->ctx, &ply->element, &ply->element_capacity, (size_t)ply->elements + 1,
                            sizeof element);
    if (h->rc == OXL_OK) ply->element[ply->elements++] = element;
}

static enum ply_type ply_header_type(struct ply_header *h, int word)
{
    for (size_t i = 0; i < OXL_COUNT(ply_type_names); i++)
        if (ply_is(h, word, ply_type_names[i].name)) return ply_type_names[i].type;
    ply_header_fail(h, "a type: char, uchar, short, ushort, int, uint, float or double");
    return PLY_INT8;
}

static void ply_header_property(struct ply_header *h)
{
    struct ply_element *element = h->ply->elements ? &h->ply->element[h->ply->elements - 1] : NULL;
    struct ply_property property = {.is_list = ply_is(h, 1, "list")};
    if (!element) ply_header_fail(h, "an element before its properties");
    if (property.is_list) property.count_type = ply_header_type(h, 2);
    if (property.count_type >= PLY_FLOAT32) ply_header_fail(h, "a whole number to count the list");
    property.type = ply_header_type(h, property.is_list ? 3 : 1);
    ply_header_name(h, property.is_list ? 4 : 2, property.name);
    if (h->rc == OXL_OK)
        h->rc = oxl_reserve(h->ctx, &element->property, &element->capacity, (size_t)element->properties + 1,
                            sizeof property);
    if (h->rc != OXL_OK) return;
    element->property[element->properties++] = property;
    element->row_bytes += ply_size(property.is_list ? property.count_type : property.type);
}

static void ply_header_comment(struct ply_header *h)
{
    struct ply *ply = h->ply;
    const char *from = h->word[0] + h->length[0], *end = h->line_end;
    char *copy;
    while (from < end && ply_blank(*from)) from++;
    while (end > from && ply_blank(end[-1])) end--;
    h->rc = oxl_reserve(h->ctx, &ply->comment, &ply->comment_capacity, (size_t)ply->comments + 1,
                        sizeof *ply->comment);
    copy = h->rc == OXL_OK ? oxl_calloc(h->ctx, (size_t)(end - from) + 1, 1) : NULL;
    if (!copy) h->rc = OXL_ERR_MEMORY;
    else ply->comment[ply->comments++] = memcpy(copy, from, (size_t)(end - from));
}

static void ply_header_line(struct ply_header *h)
{
    if (h->rc != OXL_OK || h->words == 0 || ply_is(h, 0, "obj_info")) return;
    if (ply_is(h, 0, "comment")) ply_header_comment(h);
    else if (ply_is(h, 0, "format")) ply_header_format(h);
    else if (ply_is(h, 0, "element")) ply_header_element(h);
    else if (ply_is(h, 0, "property")) ply_header_property(h);
    else ply_header_fail(h, "format, comment, element, property or end_header");
}

static oxl_result ply_read_header(oxl_context *ctx, struct ply *ply)
{
    struct ply_header h = {
        .ctx = ctx, .ply = ply, .cursor = ply->file.data, .end = ply->file.data + ply->file.size};
    if (ply->file.size < 4 || memcmp(ply->file.data, "ply", 3) ||
        (!ply_blank(ply->file.data[3]) && ply->file.data[3] != '\n')) {
        h.line = 1;
        h.line_start = h.cursor;
        h.line_end = h.end;
        ply_header_fail(&h, "a PLY file, whose first line is 'ply'");
        return h.rc;
    }
    ply_next_line(&h);
    while (h.rc == OXL_OK) {
        ply_next_line(&h);
        if (ply_is(&h, 0, "end_header")) break;
        ply_header_line(&h);
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
                "%s: element %s announces %llu rows, with which the data need at least %.0f bytes; there are %.0f\n"
                "fix: the file was cut short or its header is wrong; copy or export it again",
                ply->path, element->name, (unsigned long long)element->rows, need, there);
    }
    return OXL_OK;
}

/* ---------------- the data */

static inline uint64_t ply_bits(const unsigned char *p, size_t size, int big_endian)
{
    uint64_t bits = 0;
    for (size_t i = 0; i < size; i++) bits |= (uint64_t)p[i] << 8 * (big_endian ? size - 1 - i : i);
    return bits;
}

static double ply_value(const unsigned char *p, enum ply_type type, int big_endian)
{
    const uint64_t bits = ply_bits(p, ply_size(type), big_endian);
    const uint32_t word = (uint32_t)bits;
    double d;
    float f;
    switch (type) {
    case PLY_INT8: return (double)bits - (bits >> 7 ? 256 : 0);
    case PLY_INT16: return (double)bits - (bits >> 15 ? 65536 : 0);
    case PLY_INT32: return (double)bits - (bits >> 31 ? 4294967296.0 : 0);
    case PLY_UINT8:
    case PLY_UINT16:
    case PLY_UINT32: return (double)bits;
    case PLY_FLOAT32: memcpy(&f, &word, sizeof f); return f;
    case PLY_FLOAT64: memcpy(&d, &bits, sizeof d); return d;
    }
    return 0;
}

static void ply_store(const struct ply_target *target, size_t row, double value)
{
    if (target->as_float) target->as_float[row] = (float)value;
    if (target->as_double) target->as_double[row] = value;
}

/* Holds the state of the three readers. cursor: the element's bytes; target: (properties), or
 * NULL to skip the element. */
struct ply_rows {
    oxl_context *ctx;
    const struct ply *ply;
    const struct ply_element *element;
    const struct ply_target *target;
    const char *cursor, *end;
};

static oxl_result ply_cut_short(const struct ply_rows *r, uint64_t row)
{
    return oxl_fail(
        r->ctx, OXL_ERR_INPUT,
        "%s: byte %zu: the file ends in row %llu of %llu of element %s\nfix: copy or export it again",
        r->ply->path, (size_t)(r->cursor - r->ply->file.data), (unsigned long long)row,
        (unsigned long long)r->element->rows, r->element->name);
}

static oxl_result ply_read_binary(struct ply_rows *r)
{
    const int big_endian = r->ply->format == PLY_BIG;
    for (uint64_t row = 0; row < r->element->rows; row++) {
        for (int c = 0; c < r->element->properties; c++) {
            const struct ply_property *p = &r->element->property[c];
            const enum ply_type type = p->is_list ? p->count_type : p->type;
            const size_t size = ply_size(type);
            double value;
            if ((size_t)(r->end - r->cursor) < size) return ply_cut_short(r, row);
            value = ply_value((const unsigned char *)r->cursor, type, big_endian);
            r->cursor += size;
            if (!p->is_list) {
                if (r->target) ply_store(&r->target[c], (size_t)row, value);
                continue;
            }
            if (value < 0 || value * (double)ply_size(p->type) > (double)(r->end - r->cursor))
                return ply_cut_short(r, row);
            r->cursor += (size_t)value * ply_size(p->type);
        }
    }
    return OXL_OK;
}

static oxl_result ply_ascii_fail(const struct ply_rows *r, uint64_t row, const char *wanted)
{
    char seen[48];
    int line = r->ply->data_line;
    for (const char *c = r->ply->file.data + r->ply->data; c < r->cursor; c++) line += *c == '\n';
    return oxl_fail(
        r->ctx, OXL_ERR_INPUT,
        "%s:%d: row %llu of element %s: found '%s', expected %s\nfix: correct the line or export the file again",
        r->ply->path, line, (unsigned long long)row, r->element->name, ply_printable(r->cursor, r->end, seen),
        wanted);
}

static int ply_ascii_number(struct ply_rows *r, double *out)
{
    while (r->cursor < r->end && ply_blank(*r->cursor)) r->cursor++;
    return parse_double(&r->cursor, r->end, out) &&
           (r->cursor == r->end || ply_blank(*r->cursor) || *r->cursor == '\n');
}

/* Reads one row per line, as the format requires, so that an error names the row with a missing value. */
static oxl_result ply_read_ascii(struct ply_rows *r)
{
    for (uint64_t row = 0; row < r->element->rows; row++) {
        double value;
        while (r->cursor < r->end && (ply_blank(*r->cursor) || *r->cursor == '\n')) r->cursor++;
        for (int c = 0; c < r->element->properties; c++) {
            if (!ply_ascii_number(r, &value)) return ply_ascii_fail(r, row, "a number for each property");
            if (!r->element->property[c].is_list) {
                if (r->target) ply_store(&r->target[c], (size_t)row, value);
                continue;
            }
            if (!(value >= 0 && value <= (double)(r->end - r->cursor)))
                return ply_ascii_fail(r, row, "a list that fits the file");
            for (size_t left = (size_t)value; left > 0; left--)
                if (!ply_ascii_number(r, &value))
                    return ply_ascii_fail(r, row, "as many numbers as the list announces");
        }
        while (r->cursor < r->end && ply_blank(*r->cursor)) r->cursor++;
        if (r->cursor < r->end && *r->cursor != '\n') return ply_ascii_fail(r, row, "the end of the line");
    }
    return OXL_OK;
}

static oxl_result ply_rows(struct ply_rows *r)
{
    if (r->element->properties == 0) return OXL_OK; /* Skips rows without bytes. */
    if (r->ply->format == PLY_ASCII) return ply_read_ascii(r);
    return ply_read_binary(r);
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
    struct ply_rows w = {
        .ctx = ctx, .ply = ply, .cursor = ply->file.data + ply->data, .end = ply->file.data + ply->file.size};
    for (int e = 0; e <= element; e++) {
        oxl_result rc;
        w.element = &ply->element[e];
        w.target = e == element ? target : NULL;
        rc = ply_rows(&w);
        if (rc != OXL_OK) return rc;
    }
    return OXL_OK;
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
    for (int c = 0; c < ply->comments; c++) oxl_free(ctx, ply->comment[c]);
    OXL_FREE(ctx, ply->element, ply->comment, ply->path);
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
