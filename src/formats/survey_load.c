/* survey_load.c - loads a scene from a survey's folder, which a file in it stands for, too: finds and reads
 * its files, from which scene_build.c builds the scene.
 */
#include "formats.h"
#include "survey_read.h"
#include "../survey/scene.h"

static oxl_result scene_fail_folder(oxl_context *ctx, const char *folder, const char *option,
                                    const char *holds)
{
    return oxl_fail(ctx, OXL_ERR_INPUT, "%s: there is no such folder\nfix: %s names the folder of %s", folder,
                    option, holds);
}

/* Warns of a folder that may hold masks and is not used. */
static void scene_name_masks(oxl_context *ctx, const char *path)
{
    static const char *const others[] = {"mask", "Masks", "Mask", "segmentation", "images_mask"};
    for (size_t i = 0; i < OXL_COUNT(others); i++) {
        const char *folder = PATH(path, "%s", others[i]);
        if (!os_is_folder(folder)) continue;
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "%s is not used: masks are in %s/masks\nfix: --masks %s, if its black pixels are to be ignored",
            folder, path, SHELL_WORD(folder));
        return;
    }
}

/* Reads the survey's files and finds the folders of images and masks. */
static oxl_result scene_open(oxl_context *ctx, const char *path, const char *file, const oxl_scene_options *o,
                             oxl_scene *scene)
{
    const char *images = survey_folder((char[PATH_LENGTH]){0}, path, o->images, "images");
    const char *masks = survey_folder((char[PATH_LENGTH]){0}, path, o->masks, "masks");
    oxl_result rc = survey_find_model(ctx, path, o->sparse, o->images ? images : NULL, file, &scene->colmap);
    if (rc == OXL_OK && scene->colmap.is_truncated && !o->allow_truncated)
        rc = oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%s: a file in this folder holds fewer rows than its header announces (see the warning), "
            "expected all of them\nfix: export the model again: colmap model_converter --output_type "
            "TXT; or train on the rows that exist: --force",
            scene->colmap.folder);
    scene->from_files = 1;
    scene->max_missing = o->missing_images;
    scene->images = oxl_strdup(ctx, o->images || !scene->colmap.images ? images : scene->colmap.images);
    scene->masks = oxl_strdup(ctx, masks);
    if (rc != OXL_OK) return rc;
    if (!scene->images || !scene->masks) return OXL_ERR_MEMORY;
    scene->stats.images_listed = (int)scene->colmap.image_count;
    if (o->read_images && !os_is_folder(scene->images))
        return scene_fail_folder(ctx, scene->images, "--images", "images");
    if (os_is_folder(scene->masks)) return OXL_OK;
    if (o->masks) return scene_fail_folder(ctx, o->masks, "--masks", "masks");
    oxl_free(ctx, scene->masks);
    scene->masks = NULL;
    scene_name_masks(ctx, path);
    return OXL_OK;
}

oxl_result oxl_scene_load(oxl_context *ctx, const char *path, const oxl_scene_options *options,
                          oxl_scene **out)
{
    const oxl_scene_options o = options ? *options : oxl_scene_options_default();
    const char *file = os_is_file(path) ? path_base_name(path) : NULL,
               *folder = PATH("", "%.*s", file > path ? (int)(file - path) - 1 : 0, path);
    oxl_scene *scene = oxl_calloc(ctx, 1, sizeof *scene);
    oxl_result rc;
    *out = NULL;
    if (!scene) return OXL_ERR_MEMORY;
    if (file) path = *folder ? folder : ".";
    rc = scene_open(ctx, path, file, &o, scene);
    if (rc == OXL_OK) rc = scene_build(ctx, scene, &o);
    if (rc != OXL_OK) oxl_scene_free(ctx, scene);
    else *out = scene;
    return rc;
}
