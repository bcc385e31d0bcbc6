/* cases.h - declares what several test files share: surveys, small runs, listeners; and internal functions of
 * src/ that no header declares, because no other module calls them. */
#ifndef TEST_CASES_H
#define TEST_CASES_H

#include "../lab/synth.h"

/* ---------------- shared by test files */

/* test.c */
void *counting_reallocate(void *user, void *old, size_t size);
void memory_weigh_end(void);
void memory_weigh_start(size_t limit); /* bytes; 0: none */
struct memory_weighed {
    size_t held, most, limit; /* bytes */
    int calls;                /* each moves the memory to another place within a cache line */
};
extern struct memory_weighed memory_weighed;
extern long blocks_held;      /* given by the counting allocator and not yet freed */
extern long allocations_left; /* until the counting allocator refuses one; LONG_MAX before each test */

struct colmap_observed {
    struct colmap_observation {
        double x, y;
        int64_t point;
    } * at;
    size_t *first; /* (images + 1) */
};
/* test_colmap.c */
extern const char colmap_good_cameras[];
extern const char colmap_good_images[];
extern const char colmap_good_points[];
struct colmap_observed colmap_observe(const char *folder, const struct colmap *c);
size_t colmap_observed_count(const struct colmap_observed *o, size_t image);
void colmap_observed_free(struct colmap_observed *o);
int colmap_same(const struct colmap *a, const struct colmap *b);
oxl_result colmap_read_folder(const char *folder, struct colmap *out);
struct colmap colmap_of(const char *cameras, const char *images, const char *points);
oxl_result colmap_try(const char *cameras, const char *images, const char *points, struct colmap *out);

enum { JOB_VIEWS = 9, JOB_WIDTH = 48, JOB_HEIGHT = 32 };
struct job_test_watch {
    int calls, stop_at;
};
/* test_job.c */
oxl_metrics job_test_evaluate(const char *model, int imaging);
int job_test_has(const char *file, const char *words);
/* Runs the survey of the test's folder, which is made if it is not there, into the folder `out` beside it. */
oxl_result job_test_run(const char *out, const oxl_job_options *options);
void job_test_done(const char *out, const oxl_job_options *options);
oxl_result job_test_watched(const char *out, const oxl_job_options *options, struct job_test_watch *watch);
oxl_result job_test_image(const char *path, int view);
oxl_job_options job_test_options(void);
int job_test_progress(void *user, const oxl_progress *p);
void job_test_replace(const char *file, const char *from, const char *to);
const char *job_test_survey(void);
const char *job_test_survey_of(int points);

struct prune_case {
    oxl_scene *scene;
    struct trained_model trained;
};
/* cases.c */
/* Writes the three text files of a survey into the test's folder. */
void test_write_colmap(const char *folder, const char *cameras, const char *images, const char *points);
/* Writes a state and reads it back. */
void test_archive(void (*archive)(struct archive *a, void *user), void *written, void *read);
/* The figures alone: its list of views is freed. */
oxl_metrics test_evaluate(const oxl_model *model, const oxl_scene *scene, const struct oxl_imaging *imaging,
                          oxl_split split);
size_t test_rows(const oxl_model *m, int plane);             /* 0: m has no such plane */
int test_same_model(const oxl_model *a, const oxl_model *b); /* 1: the same bytes */
void prune_case_free(struct prune_case *c);
#define OWNED_PRUNE_CASE __attribute__((cleanup(prune_case_free))) struct prune_case
struct prune_case prune_two_patches(int many, int few, float low);

/* test_scene.c */
const char *scene_survey(const char *name, int n, double base, int with_files);

/* test_synth.c */
void synth_test_make(const synth_options *o, struct colmap *survey);
synth_options synth_test_options(const char *name);

/* test_train.c */
oxl_train_options train_options(int iterations);
double train_psnr(oxl_scene *scene, const oxl_model *model);
oxl_scene *train_scene(int views);
/* train_scene with other names (NULL: the same), and images as `change` leaves them (NULL: the same). */
oxl_scene *train_scene_changed(int views, const char *const *names,
                               void (*change)(const void *how, const oxl_scene *scene, int view,
                                              oxl_image *image),
                               const void *how);
oxl_scene *train_scene_of(int views, double shine);
/* As train_scene_changed, with images of a stereo pair's left and right camera in turn. */
oxl_scene *train_scene_of_pairs(int views,
                                void (*change)(const void *how, const oxl_scene *scene, int view,
                                               oxl_image *image),
                                const void *how);

struct checkpoint_case {
    oxl_scene *scene;
    oxl_train_options options;
    struct text log, notes, decisions;
    int first;       /* iteration that the last run reported first */
    oxl_model whole; /* of a run that nothing disturbed */
};
/* test_train_resume.c */
void checkpoint_case_free(struct checkpoint_case *c);
#define OWNED_CHECKPOINT_CASE __attribute__((cleanup(checkpoint_case_free))) struct checkpoint_case
struct checkpoint_case checkpoint_of(oxl_scene *scene, oxl_train_options options);
oxl_result checkpoint_run(struct checkpoint_case *c, const char *key, int until, oxl_model *out);
void checkpoint_stop_at(struct checkpoint_case *c, int step);
/* The run (c->whole), stopped after each of these steps (to 0) and resumed, ends in the same model and imaging. */
void checkpoint_check_stops(struct checkpoint_case *c, const int *stop);

/* test_underwater.c */
struct lamp lamp_of(int view);
struct oxl_imaging imaging_test_make(int views, const int *known, int count);
synth_options photometry_test_make(const char *name, enum synth_type water);

/* ---------------- internal to modules of src/ */

/* src/core/options.c */
int option_read_keep(const char *text, oxl_keep *out);
/* src/large/block_plan.c */
double plan_best_rectangle(double *value, int width, int height, struct image_window *best);
/* src/job/render_files.c */
void render_depth_grey(float *depth, size_t pixels, double unit, float *grey);
/* src/render/renderer_step.c */
float *render_depth_sums(const struct renderer_sums *s, float depth);
/* src/survey/camera.c */
double camera_atan(double x);
/* src/survey/robust_stats.c */
int stats_compare(const void *a, const void *b);
/* src/train/density.c */
struct renderer_sums density_sums(const struct density *d, size_t count);
/* src/train/step.c */
oxl_result step_on_view(struct train *t, const struct train_deferred *here, int deferred);
/* src/train/train_loop.c */
void train_archive(struct archive *a, void *user);
oxl_result train_begin(struct train *t);
oxl_result train_density(struct train *t);
void train_end(struct train *t);
oxl_result train_resume(struct train *t);
/* src/formats/spz.c */
extern const signed char spz_turn_sh[15];
/* src/core/number.c */
extern const double number_power10[];

#endif
