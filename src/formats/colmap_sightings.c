/* colmap_sightings.c - reads where an image saw its points: the 2D points of images.txt or images.bin.
 *
 * Only one image's are in memory: a large survey has 10^8.
 */
#include "survey_read.h"
#include "../core/bytes.h"

enum { SIGHTINGS_BINARY = 24 }; /* bytes of a 2D point in images.bin */

OXL_INTERNAL oxl_result colmap_sightings_open(oxl_context *ctx, const struct colmap *c, size_t room,
                                              struct colmap_sightings *out)
{
    size_t most = 0;
    for (size_t i = 0; i < c->image_count; i++) most = OXL_MAX(most, c->image[i].points_size);
    *out = (struct colmap_sightings){.colmap = c, .room = OXL_MIN(most, room)};
    out->text = oxl_alloc(ctx, out->room + 1, 1);
    return out->text ? os_reader_open(ctx, path_in(out->path, c->folder, "%s", c->images_file), &out->file)
                     : OXL_ERR_MEMORY;
}

OXL_INTERNAL void colmap_sightings_close(oxl_context *ctx, struct colmap_sightings *s)
{
    os_reader_close(&s->file);
    oxl_free(ctx, s->text);
}

OXL_INTERNAL oxl_result colmap_sightings_of(oxl_context *ctx, struct colmap_sightings *s,
                                            const struct colmap_image *image)
{
    const size_t wanted = OXL_MIN(image->points_size, s->room);
    size_t got = 0;
    oxl_result rc = wanted ? os_reader_seek(ctx, &s->file, image->points_at) : OXL_OK;
    if (wanted && rc == OXL_OK) rc = os_reader_read(ctx, &s->file, s->text, wanted, &got);
    if (rc == OXL_OK && got < wanted)
        rc = oxl_fail(ctx, OXL_ERR_INPUT,
                      "%s: ends within the 2D points of an image; it was longer when the survey was read\n"
                      "fix: export the survey again, or run again if another program is writing it",
                      s->path);
    s->at = s->text, s->end = s->text + got;
    return rc;
}

static const struct colmap_point *sightings_find(const struct colmap *c, int64_t id)
{
    size_t low = 0, high = c->point_count;
    while (low < high) {
        const size_t middle = low + (high - low) / 2;
        if (c->point[middle].id < id) low = middle + 1;
        else high = middle;
    }
    return low < c->point_count && c->point[low].id == id ? &c->point[low] : NULL;
}

static const char *sightings_skip(const char *p, const char *end)
{
    while (p < end && (*p == ' ' || *p == '\t')) p++;
    return p;
}

/* Reads the next 2D point of the list; 0: the list has ended. */
static int sightings_read(struct colmap_sightings *s, double pixel[2], int64_t *id)
{
    if (s->colmap->format == COLMAP_TEXT) {
        for (int k = 0; k < 2; k++) {
            s->at = sightings_skip(s->at, s->end);
            if (!parse_double(&s->at, s->end, &pixel[k])) return 0;
        }
        s->at = sightings_skip(s->at, s->end);
        return parse_int64(&s->at, s->end, id);
    }
    if (s->end - s->at < SIGHTINGS_BINARY) return 0;
    pixel[0] = bytes_double(s->at), pixel[1] = bytes_double(s->at + 8);
    *id = (int64_t)bytes_get(s->at + 16, 8);
    s->at += SIGHTINGS_BINARY;
    return 1;
}

OXL_INTERNAL int colmap_sightings_next(struct colmap_sightings *s, struct colmap_sighting *out)
{
    int64_t id;
    while (sightings_read(s, out->pixel, &id)) {
        const struct colmap_point *point = id >= 0 ? sightings_find(s->colmap, id) : NULL;
        if (!point) continue;
        memcpy(out->world, point->position, sizeof point->position);
        return 1;
    }
    return 0;
}
