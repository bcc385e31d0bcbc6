/* ply.h - reads PLY files (ply.c): points of a survey, and models. */
#ifndef OXL_PLY_H
#define OXL_PLY_H

#include "../core/core.h"

enum { PLY_NAME = 64 };
enum ply_type { PLY_INT8, PLY_UINT8, PLY_INT16, PLY_UINT16, PLY_INT32, PLY_UINT32, PLY_FLOAT32, PLY_FLOAT64 };
enum ply_format { PLY_NO_FORMAT, PLY_ASCII, PLY_LITTLE, PLY_BIG };

struct ply_property {
    char name[PLY_NAME];
    enum ply_type type;
    enum ply_type count_type; /* type of a list's length */
    int is_list;
};
struct ply_element {
    char name[PLY_NAME];
    uint64_t rows; /* the file is checked to hold at least this many rows */
    struct ply_property *property;
    int properties;
    size_t capacity;
    size_t row_bytes; /* bytes of a binary row; the least if there are lists */
};
struct ply {
    char *path;
    struct os_file_map file;
    enum ply_format format;
    size_t data; /* offset of the first byte after the header, whose comments are not parsed */
    int data_line;
    struct ply_element *element;
    int elements;
    size_t element_capacity;
};
/* Receives the values (rows) of a property, converted; both NULL: the property is
 * skipped, as lists always are. */
struct ply_target {
    float *as_float;
    double *as_double;
};
/* Reads the file and checks its header. */
OXL_INTERNAL oxl_result ply_open(oxl_context *ctx, const char *path, struct ply *out);
/* Reads an element. target: (properties of the element). */
OXL_INTERNAL oxl_result ply_read(oxl_context *ctx, const struct ply *ply, int element,
                                 const struct ply_target *target);
/* Returns the value of full white in colours of this type. */
OXL_INTERNAL double ply_white(enum ply_type type);
OXL_INTERNAL void ply_close(oxl_context *ctx, struct ply *ply);
OXL_INTERNAL int ply_find_element(const struct ply *ply, const char *name); /* -1: none */
/* Returns -1 if there is no such property, or it is a list. */
OXL_INTERNAL int ply_find_property(const struct ply_element *element, const char *name);

#endif
