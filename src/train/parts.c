/* parts.c - calls a hook of all parts, row by row (part.h). */
#include "parts_calls.h"

/* Takes the memory of all states at once, so that there are all or none. */
OXL_INTERNAL oxl_result parts_create(struct train *t)
{
    enum { ALIGNMENT = 64 };
    size_t at[TRAIN_PARTS_MAX], size = 0;
    char *memory;
    int count = 0;
    for (; parts_at(count); count++) {
        if (count == TRAIN_PARTS_MAX)
            return oxl_fail(t->ctx, OXL_ERR_FAILED, "more than %d parts", TRAIN_PARTS_MAX);
        at[count] = size;
        size += (parts_at(count)->size + ALIGNMENT) / ALIGNMENT * ALIGNMENT;
    }
    memory = oxl_calloc(t->ctx, size + 1, 1);
    if (!memory) return OXL_ERR_MEMORY;
    for (int k = 0; k < count; k++) t->part[k] = memory + at[k];
    return OXL_OK;
}

OXL_INTERNAL void parts_free(struct train *t)
{
    if (!t->part[0]) return;
    PARTS_FOR(k, free) parts_at(k)->free(t, t->part[k]);
    oxl_free(t->ctx, t->part[0]);
    t->part[0] = NULL;
}

OXL_INTERNAL int parts_tracks(const struct train *t)
{
    int wanted = 0;
    PARTS_FOR(k, tracks) wanted |= parts_at(k)->tracks(t, t->part[k]);
    return wanted;
}

OXL_INTERNAL void parts_use_tracks(struct train *t, const struct photometry *p)
{
    PARTS_FOR(k, use_tracks)
    if (parts_tracks(t) == p->requested) parts_at(k)->use_tracks(t, t->part[k], p);
}

OXL_INTERNAL void parts_set_gain(struct train *t, struct train_deferred *step, int learns)
{
    PARTS_FOR(k, set_gain) parts_at(k)->set_gain(t, t->part[k], step, learns);
}

OXL_INTERNAL void parts_form_image(const struct train *t, struct oxl_imaging *m)
{
    PARTS_FOR(k, form_image) parts_at(k)->form_image(t->part[k], m);
}

OXL_INTERNAL int parts_hide(struct train *t)
{
    struct oxl_imaging m = {0};
    struct train_deferred step = {0};
    parts_form_image(t, &m);
    parts_set_gain(t, &step, 0);
    m.on = step.has_gain;
    return imaging_hides(&m);
}

OXL_INTERNAL double parts_bytes(const oxl_train_options *options, int views)
{
    double bytes = 0;
    PARTS_FOR(k, bytes) bytes += parts_at(k)->bytes(options, views);
    return bytes;
}
