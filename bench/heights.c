/* heights.c - how far rendered depths are from the points of a survey, and from the truth of a synthetic one.
 *
 *     build/heights MAX_SIDE MODEL SURVEY
 *
 * Of all views: the camera z of MODEL at each observation of a point with a track of HEIGHTS_TRACK images or
 * more, against the point's; and, where SURVEY/truth/depth/NAME.pfm exists, at each pixel against the truth.
 * It prints the median of |error| / z, the share of pixels without depth, and for the truth the rms of
 * error / z, of all pixels and without the HEIGHTS_EDGE of them that are farthest off: at the rims of objects.
 */
#include "../oceanxl.c"

#define HEIGHTS_EDGE 0.01
enum { HEIGHTS_TRACK = 3 };

struct heights {
    double *error; /* relative */
    size_t count, capacity, without, pixels;
};

static void heights_add(struct heights *h, double depth, double truth)
{
    h->pixels++;
    h->without += !(depth > 0);
    if (!(depth > 0)) return;
    if (h->count == h->capacity) h->error = realloc(h->error, (h->capacity += 1 << 20) * sizeof *h->error);
    if (!h->error) exit(1);
    h->error[h->count++] = fabs(depth - truth) / truth;
}

static int heights_compare(const void *a, const void *b)
{
    return (*(const double *)a > *(const double *)b) - (*(const double *)a < *(const double *)b);
}

static void heights_print(struct heights *h, const char *what)
{
    const size_t inner = (size_t)((1 - HEIGHTS_EDGE) * (double)h->count);
    double sum = 0, all = 0;
    if (!h->count) return;
    qsort(h->error, h->count, sizeof *h->error, heights_compare);
    for (size_t i = 0; i < h->count; i++) {
        all += h->error[i] * h->error[i];
        if (i < inner) sum += h->error[i] * h->error[i];
    }
    printf("%s: median %.3f %%, rms %.2f %%, of the nearest %.0f %% %.2f %%, without depth %.2f %% of %zu\n",
           what, 100 * h->error[h->count / 2], 100 * sqrt(all / (double)h->count), 100 * (1 - HEIGHTS_EDGE),
           100 * sqrt(sum / (double)inner), 100 * (double)h->without / (double)h->pixels, h->pixels);
}

static void heights_add_points(struct heights *h, const oxl_scene *scene, int v, const float *depth)
{
    const struct colmap *c = scene_colmap(scene);
    const oxl_camera *camera = &oxl_scene_view(scene, v)->camera;
    const uint32_t row = (uint32_t)(scene_source_image(scene, v) - c->image);
    for (size_t i = 0; i < c->point_count; i++) {
        const struct colmap_point *p = &c->point[i];
        double x[3], at[2];
        int seen = 0;
        for (uint32_t k = 0; k < p->track_count; k++) seen |= c->track[p->first_track + k].image_row == row;
        if (!seen || p->track_count < HEIGHTS_TRACK) continue;
        if (!camera_project(camera, p->position, oxl_scene_origin(scene), x, at)) continue;
        if (at[0] >= 0 && at[1] >= 0 && at[0] < camera->width && at[1] < camera->height)
            heights_add(h, (double)depth[(size_t)at[1] * (size_t)camera->width + (size_t)at[0]], x[2]);
    }
}

/* Of a view whose truth has the size of its render. */
static void heights_add_truth(struct heights *h, const char *survey, const oxl_view *view, const float *depth)
{
    char path[1024];
    int width = 0, height = 0;
    float value;
    FILE *file;
    snprintf(path, sizeof path, "%s/truth/depth/%.*s.pfm", survey, (int)strcspn(view->name, "."), view->name);
    file = fopen(path, "rb");
    if (file && fscanf(file, "Pf %d %d %*f", &width, &height) == 2 && width == view->camera.width &&
        height == view->camera.height && fgetc(file) == '\n')
        for (int y = height - 1; y >= 0; y--)
            for (int x = 0; x < width && fread(&value, 4, 1, file) == 1; x++)
                if (value > 0)
                    heights_add(h, (double)depth[(size_t)y * (size_t)width + (size_t)x], (double)value);
    if (file) fclose(file);
}

int main(int argc, char **argv)
{
    oxl_context *ctx = NULL;
    oxl_scene_options options = oxl_scene_options_default();
    oxl_scene *scene = NULL;
    oxl_model model = {0};
    struct renderer *r = NULL;
    struct heights points = {0}, truth = {0};
    if (argc != 4 || oxl_context_create(NULL, &ctx) != OXL_OK) {
        fputs("usage: heights MAX_SIDE MODEL SURVEY\n", stderr);
        return 2;
    }
    options.max_side = atoi(argv[1]);
    if (oxl_model_read(ctx, argv[2], &model) != OXL_OK ||
        oxl_scene_load(ctx, argv[3], &options, &scene) != OXL_OK || renderer_create(ctx, &r) != OXL_OK) {
        fprintf(stderr, "%s\n", oxl_error_text(ctx));
        return 1;
    }
    oxl_model_move_origin(&model, oxl_scene_origin(scene));
    for (int v = 0; v < oxl_scene_view_count(scene); v++) {
        const oxl_view *view = oxl_scene_view(scene, v);
        oxl_image image = {0};
        float *depth = malloc(sizeof *depth * (size_t)view->camera.width * (size_t)view->camera.height);
        if (depth &&
            evaluate_draw(ctx, &(struct drawn){r, &model, scene, NULL}, v, &image, depth) == OXL_OK) {
            if (scene_colmap(scene)) heights_add_points(&points, scene, v, depth);
            heights_add_truth(&truth, argv[3], view, depth);
        }
        oxl_image_free(ctx, &image);
        free(depth);
    }
    heights_print(&points, "points");
    heights_print(&truth, "truth");
    return points.count + truth.count == 0;
}
