/* out_folder.c - refuses folders as OUT: one that the survey is read from, or one with files of a run's names
 * that no run wrote.
 *
 * Both would lose files that cannot be made again: points of transforms.json that are named scene.ply, the
 * model, the report or the blocks of another program.
 */
#include "job.h"
#include "../formats/formats.h"
#include "../large/os_job.h"

OXL_INTERNAL oxl_result out_check_inputs(oxl_context *ctx, const char *out, const char *scene,
                                         const oxl_scene_options *o)
{
    const struct {
        const char *path, *holds;
    } inputs[] = {{scene, "survey"},
                  {survey_folder((char[PATH_LENGTH]){0}, scene, o->images, "images"), "images"},
                  {survey_folder((char[PATH_LENGTH]){0}, scene, o->masks, "masks"), "masks"},
                  {survey_folder((char[PATH_LENGTH]){0}, scene, o->sparse, "sparse"), "COLMAP model"},
                  {PATH(scene, "sparse/0"), "COLMAP model"}};
    for (size_t i = 0; i < OXL_COUNT(inputs); i++)
        if (os_is_same(out, inputs[i].path))
            return oxl_fail(
                ctx, OXL_ERR_USAGE,
                "%s holds the %s, which the output could replace\nfix: use a folder of its own, such as %s",
                out, inputs[i].holds, SHELL_WORD(PATH(scene, "out")));
    return OXL_OK;
}

OXL_INTERNAL oxl_result out_check_files(oxl_context *ctx, const char *out)
{
    static const char *const files[] = {"scene.ply",   "scene_standard.ply", "scene_clear.ply", "imaging.txt",
                                        "report.html", "metrics.json",       "run.json"};
    for (size_t i = 0; i < OXL_COUNT(files); i++)
        if (os_is_file(PATH(out, "%s", files[i])))
            return oxl_fail(ctx, OXL_ERR_USAGE,
                            "%s/%s exists, but no run.json shows which run wrote it\nfix: name "
                            "another output folder; --restart replaces it",
                            out, files[i]);
    return OXL_OK;
}
