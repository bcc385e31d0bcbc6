/* colmap.h - shared by the readers of COLMAP's files: a buffer on a file, its lines, their fields, tables of
 * ids.
 *
 * Functions are in colmap_text.c unless stated. colmap.c reads cameras.txt and images.txt, colmap_points.c
 * points3D.txt, and colmap_binary.c the binary files.
 */
#ifndef OXL_COLMAP_H
#define OXL_COLMAP_H

#include "../survey/sparse.h"

#include <inttypes.h>

/* Finds rows by id, by open addressing over an array whose elements begin with their int64_t id. */
struct colmap_index {
    uint32_t *slot; /* (slots) row + 1; 0: empty */
    size_t slots;   /* a power of 2, at least twice the rows */
};

enum colmap_warning {
    WARN_NO_POINTS_LINE,
    WARN_QUATERNION,
    WARN_POSITION,
    WARN_ERROR,
    WARN_TRACK,
    WARN_COUNT
};

#define COLMAP_FIX_EXPORT "export the model again: colmap model_converter --output_type TXT"

/* Limits how far the length of a quaternion may differ from 1 without a warning. */
#define COLMAP_UNIT_ERROR 1e-2
enum { COLMAP_BUFFER = 8 << 20 }; /* bytes */

struct colmap_reader {
    oxl_context *ctx;
    struct colmap *out;
    char *path;
    struct os_reader file;
    oxl_result rc;            /* error of reading; not OXL_OK if the lines ended before the end of the file */
    char *buffer;             /* a part of the file, followed by a zero byte */
    size_t room;              /* capacity of the buffer in bytes, with the zero */
    size_t buffer_size;       /* bytes of a file to hold at a time; a longer line widens the buffer */
    uint64_t offset;          /* position of the buffer in the file */
    int at_end;               /* the buffer holds the end of the file */
    const char *limit;        /* end of the data in the buffer */
    const char *next;         /* first byte after this line */
    const char *cursor, *end; /* rest of this line, without blanks at its ends */
    int line;                 /* from 1; in a binary file, the record */
    uint64_t declared;        /* rows stated by COLMAP's comment at the start of the file; 0: not stated */
    int is_quiet;             /* 1: sets `suppressed` instead of writing messages */
    int suppressed;
    size_t warned[WARN_COUNT];
    struct colmap_index cameras, images;
    size_t camera_capacity, image_capacity, point_capacity, track_capacity, names_capacity;
    const char *image_folder; /* folder in which names of a survey in JSON start; NULL: as the file has it */
    /* px; size of the first image, for a survey in JSON that does not state it; 0: not read yet */
    int width, height;
};

/* Opens a file of the folder and fills the first buffer. colmap_compare warns if there are fewer rows than
 * the header states. colmap_close reports the number of suppressed warnings and closes the file. */
OXL_INTERNAL oxl_result colmap_open(struct colmap_reader *r, const char *folder, const char *name);
/* Opens a file of the folder without filling the buffer. */
OXL_INTERNAL oxl_result colmap_open_bytes(struct colmap_reader *r, const char *folder, const char *name);
OXL_INTERNAL void colmap_compare(struct colmap_reader *r, const char *what, size_t count);
OXL_INTERNAL void colmap_close(struct colmap_reader *r);

/* Fills the first buffer, or fills it again after a seek to 0; skips a byte order mark. */
OXL_INTERNAL oxl_result colmap_begin(struct colmap_reader *r);

/* Moves the buffer so that it begins at `next`; enlarges it if it is full from there on. */
OXL_INTERNAL oxl_result colmap_fill(struct colmap_reader *r);
OXL_INTERNAL int colmap_next_line(struct colmap_reader *r); /* 0: end of file, or see r->rc */
/* Moves to the next line that is not blank and no comment. */
OXL_INTERNAL int colmap_next_record(struct colmap_reader *r);

/* Fails for the field at `token`: "found ..., expected WHAT, KIND". */
OXL_INTERNAL oxl_result colmap_fail_token(struct colmap_reader *r, const char *token, const char *what,
                                          const char *kind);
OXL_INTERNAL void colmap_warn(struct colmap_reader *r, enum colmap_warning kind);
/* Writes a field as text for a message. */
OXL_INTERNAL const char *colmap_printable(const char *p, const char *end, char out[64]);

/* Move the cursor past blanks and fields. The readers of a field fail if it is not of their kind: a number, a
 * finite number, an integer from low to high, an id. */
OXL_INTERNAL int colmap_is_blank(char c);
OXL_INTERNAL void colmap_skip_blanks(struct colmap_reader *r);
OXL_INTERNAL int colmap_at_field_end(const struct colmap_reader *r);
OXL_INTERNAL oxl_result colmap_real(struct colmap_reader *r, const char *what, double *out);
OXL_INTERNAL oxl_result colmap_finite(struct colmap_reader *r, const char *what, double *out);
OXL_INTERNAL oxl_result colmap_whole(struct colmap_reader *r, const char *what, int64_t low, int64_t high,
                                     int64_t *out);
OXL_INTERNAL oxl_result colmap_id(struct colmap_reader *r, const char *what, int64_t *out);

/* Returns the slot of the id, or the empty slot for it. */
OXL_INTERNAL uint32_t *colmap_index_slot(const struct colmap_index *x, const void *rows, size_t stride,
                                         int64_t id);
/* Adds a row, unless its id is there already, which is an error. */
OXL_INTERNAL oxl_result colmap_add_camera(struct colmap_reader *r, const struct colmap_camera *camera);
OXL_INTERNAL oxl_result colmap_add_image(struct colmap_reader *r, const struct colmap_image *image);
/* Returns 0, with a warning, for a position that is not finite; sets an error that is not finite to -1. */
OXL_INTERNAL int colmap_check_point(struct colmap_reader *r, struct colmap_point *point);
/* Fails at this line: the id is there twice. */
OXL_INTERNAL oxl_result colmap_repeated(struct colmap_reader *r, const char *what, int64_t id);

/* Check and read what text and binary files share. colmap_read_name takes the name
 * from r->cursor to r->end. */
OXL_INTERNAL int colmap_has_camera(const struct colmap_reader *r, int64_t id);
OXL_INTERNAL oxl_result colmap_check_camera(struct colmap_reader *r, int64_t id);
OXL_INTERNAL oxl_result colmap_check_rotation(struct colmap_reader *r, const double q[4]);
OXL_INTERNAL oxl_result colmap_read_name(struct colmap_reader *r, size_t *name);

/* Reads the open file points3D.txt (colmap_points.c). */
OXL_INTERNAL oxl_result colmap_read_points(struct colmap_reader *r);

/* Returns 1 if the file of points is there (colmap.c). */
OXL_INTERNAL int colmap_has_points(const char *folder, enum colmap_format format);
/* Reads the three binary files of a folder (colmap_binary.c). */
OXL_INTERNAL oxl_result colmap_read_binary(struct colmap_reader *r, const char *folder);

#endif
