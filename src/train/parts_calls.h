/* parts_calls.h - calls a hook of all parts, in the order of the table: for the loop and steps. */
#ifndef OXL_PARTS_CALLS_H
#define OXL_PARTS_CALLS_H

#include "part.h"

/* Goes through the parts that have a hook, in the order of the table; k: the row. */
#define PARTS_FOR(k, hook)            \
    for (int k = 0; parts_at(k); k++) \
        if (parts_at(k)->hook)
/* Calls such a hook of each part, until one fails; rc other than OXL_OK: of none. */
#define PARTS_CALL(rc, k, hook, ...) \
    PARTS_FOR(k, hook)               \
    if (rc == OXL_OK) rc = parts_at(k)->hook(__VA_ARGS__)

OXL_INTERNAL oxl_result parts_create(struct train *t); /* memory for the states */
OXL_INTERNAL void parts_free(struct train *t);
OXL_INTERNAL int parts_tracks(const struct train *t);
OXL_INTERNAL void parts_use_tracks(struct train *t, const struct photometry *p);
OXL_INTERNAL void parts_set_gain(struct train *t, struct train_deferred *step, int learns);
OXL_INTERNAL void parts_form_image(const struct train *t, struct oxl_imaging *m);
/* Returns 1 if images have a medium, or gains alone, so that viewers get a model of their own. */
OXL_INTERNAL int parts_hide(struct train *t);

#endif
