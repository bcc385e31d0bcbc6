/* colmap.h - shared by the readers of surveys: a file, its fields, its messages; names and rotations.
 *
 * A reader keeps its first error in `rc`. Its functions do nothing after it and return 0, so that a record is
 * read without a test of each field.
 */
#ifndef OXL_COLMAP_H
#define OXL_COLMAP_H

#include "../survey/sparse.h"
#include "survey_read.h"

#include <inttypes.h>

enum colmap_warning {
    WARN_NO_POINTS_LINE,
    WARN_QUATERNION,
    WARN_POSITION,
    WARN_ERROR,
    WARN_TRACK,
    WARN_COUNT
};

/* LC_ALL: in some languages programs write 0,5 for 0.5. */
#define COLMAP_FIX_EXPORT "export the model again: LC_ALL=C colmap model_converter --output_type TXT"
#define COLMAP_FIX_BINARY \
    "copy the file again, or write the model again: colmap model_converter --output_type BIN"

/* Limits how far the length of a quaternion may differ from 1 without a warning. */
#define COLMAP_UNIT_ERROR 1e-2
enum { COLMAP_BUFFER = 8 << 20 }; /* bytes */

struct colmap_reader {
    oxl_context *ctx;
    struct colmap *out; /* its format is that of the file */
    oxl_result rc;
    char path[PATH_LENGTH];
    struct os_reader file;
    char *buffer;             /* a part of the file */
    size_t room;              /* capacity of the buffer in bytes */
    size_t buffer_size;       /* bytes of a file to hold at a time; a longer line widens the buffer */
    uint64_t offset;          /* position of the buffer in the file */
    int at_end;               /* the buffer holds the end of the file */
    const char *limit;        /* end of the data in the buffer */
    const char *next;         /* text: first byte after this line; binary: first unread byte */
    const char *cursor, *end; /* rest of this line, without blanks at its ends */
    const char *field;        /* begin of the field read last */
    int line;                 /* from 1; in other files than text, the record */
    uint64_t rows, announced; /* records read, and stated by the file; 0: not stated */
    size_t warned[WARN_COUNT];
    size_t camera_capacity, image_capacity, point_capacity, track_capacity, names_capacity;
    struct survey_given given;
    int beside; /* 1: names in a file of JSON start in its folder; 0: in images/ there */
    /* px; size of the first image, for a survey in JSON that does not state it; 0: not read yet */
    int width, height;
};

/* ---------------- colmap_fields.c */

/* Opens a file of the folder: r->announced is its number of rows. colmap_close reports what was left out and
 * frees nothing but the file. */
OXL_INTERNAL void colmap_open(struct colmap_reader *r, const char *folder, const char *name);
OXL_INTERNAL void colmap_close(struct colmap_reader *r, const char *rows);
/* Moves to the next record: of text, a line that is not blank and no comment. 0: there is none. */
OXL_INTERNAL int colmap_next_record(struct colmap_reader *r);
OXL_INTERNAL int colmap_next_line(struct colmap_reader *r);

/* Sets the error "PLACE: TEXT", with a fix, unless there is one. */
OXL_INTERNAL oxl_result colmap_fail(struct colmap_reader *r, const char *fix, const char *format, ...)
    OXL_PRINTF(3, 4);
/* Fails for the field read last: "found ..., expected WHAT, KIND". value: of a binary field. */
OXL_INTERNAL void colmap_fail_field(struct colmap_reader *r, const char *what, const char *kind,
                                    double value);
OXL_INTERNAL void colmap_warn(struct colmap_reader *r, enum colmap_warning kind);

/* Begin and read a field, of `size` bytes in a binary file: any number, a finite number, an integer from low
 * to high, an id, a number of things that follow, each of `least` bytes or more (binary files). */
OXL_INTERNAL int colmap_field(struct colmap_reader *r, const char *what, size_t size);
OXL_INTERNAL double colmap_real(struct colmap_reader *r, const char *what);
OXL_INTERNAL double colmap_finite(struct colmap_reader *r, const char *what);
OXL_INTERNAL int64_t colmap_whole(struct colmap_reader *r, const char *what, size_t size, int64_t low,
                                  int64_t high);
OXL_INTERNAL int64_t colmap_id(struct colmap_reader *r, const char *what, size_t size);
OXL_INTERNAL uint64_t colmap_count(struct colmap_reader *r, const char *what, size_t least);
OXL_INTERNAL void colmap_skip(struct colmap_reader *r, uint64_t size); /* bytes of a binary file */
/* Moves the cursor to the name of a binary file; of text, it is the rest of the line. */
OXL_INTERNAL void colmap_begin_name(struct colmap_reader *r);
OXL_INTERNAL int colmap_is_blank(char c);
OXL_INTERNAL int colmap_at_field_end(const struct colmap_reader *r);
/* Returns 1 if the line of a text has a field after the cursor, and begins it. */
OXL_INTERNAL int colmap_has_more(struct colmap_reader *r);
/* Writes the field read last as text for a message. */
OXL_INTERNAL const char *colmap_printable(const struct colmap_reader *r, char out[64]);

/* ---------------- what all surveys share */

/* Adds a row to r->out's array of cameras, images or points, unless there is an error. */
#define COLMAP_ADD(r, array, row)                                                        \
    do {                                                                                 \
        if ((r)->rc == OXL_OK)                                                           \
            (r)->rc = oxl_reserve((r)->ctx, &(r)->out->array, &(r)->array##_capacity,    \
                                  (r)->out->array##_count + 1, sizeof *(r)->out->array); \
        if ((r)->rc == OXL_OK) (r)->out->array[(r)->out->array##_count++] = (row);       \
    } while (0)

OXL_INTERNAL void colmap_check_rotation(struct colmap_reader *r, const double q[4]);
/* Takes the name from r->cursor to r->end. */
OXL_INTERNAL void colmap_read_name(struct colmap_reader *r, size_t *name);

#endif
