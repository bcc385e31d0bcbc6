/* test_partition_export.c - blocks as files: COLMAP exports equal to the survey, the drawing, the report. */
#include "test.h"

static const struct colmap_image *export_test_image(const struct colmap *c, int64_t id)
{
    for (size_t i = 0; i < c->image_count; i++)
        if (c->image[i].id == id) return &c->image[i];
    return NULL;
}

static const char *export_test_folder(const char *out, int block)
{
    return test_path("%s/blocks/%03d/sparse/0", out, block);
}

static void export_test_check_image(const struct colmap *all, const struct colmap_observed *seen,
                                    const struct colmap *part, const struct colmap_observed *o,
                                    const struct colmap_image *image)
{
    const size_t own = (size_t)(image - part->image);
    const struct colmap_image *whole = export_test_image(all, image->id);
    CHECK(whole && memcmp(whole->rotation, image->rotation, sizeof image->rotation) == 0);
    CHECK(memcmp(whole->translation, image->translation, sizeof image->translation) == 0);
    CHECK(strcmp(all->names + whole->name, part->names + image->name) == 0 &&
          whole->camera_id == image->camera_id);
    CHECK(colmap_observed_count(seen, (size_t)(whole - all->image)) == colmap_observed_count(o, own));
    for (size_t k = 0; k < colmap_observed_count(o, own); k++) {
        const struct colmap_observation *a = &seen->at[seen->first[whole - all->image] + k],
                                        *b = &o->at[o->first[own] + k];
        CHECK(a->x == b->x && a->y == b->y && a->point == b->point);
    }
}

/* Returns 1 if the row is `point` of the survey, with the entries of its track that name views of the block. */
static int export_test_is_point(const struct colmap *all, const struct colmap *part,
                                const struct colmap_observed *o, const struct colmap_point *point,
                                const struct colmap_point *whole)
{
    uint32_t kept = 0;
    int same = whole->id == point->id &&
               memcmp(whole->position, point->position, sizeof point->position) == 0 &&
               whole->error == point->error && memcmp(whole->rgb, point->rgb, 3) == 0;
    for (uint32_t k = 0; k < whole->track_count; k++)
        kept += export_test_image(part, all->image[all->track[whole->first_track + k].image_row].id) != NULL;
    for (uint32_t k = 0; k < point->track_count; k++) {
        const struct colmap_track *t = &part->track[point->first_track + k];
        same &= t->observation < colmap_observed_count(o, t->image_row) &&
                o->at[o->first[t->image_row] + t->observation].point == point->id;
    }
    return same && kept == point->track_count;
}

TEST(partition_export_reads_back_to_the_same_numbers_with_tracks_that_point_back)
{
    OWNED_SCENE *scene = partition_test_reef_scene(2);
    struct colmap all, part;
    struct colmap_observed seen, o2;
    OWNED_PARTITION p = {0};
    CHECK_OK(colmap_read(test_ctx, test_path("reef/sparse/0"), &all));
    seen = colmap_observe(test_path("reef/sparse/0"), &all);
    p = partition_test_cut(scene, 600, OXL_CUT_BALANCED);
    CHECK_OK(partition_export(test_ctx, &p, test_path("out")));
    CHECK(p.block_count >= 3);
    for (int b = 0; b < p.block_count; b++) {
        CHECK_OK(colmap_read(test_ctx, export_test_folder("out", b), &part));
        o2 = colmap_observe(export_test_folder("out", b), &part);
        CHECK(part.warnings == 0 && part.camera_count == 1 && part.point_count == p.block[b].start_points);
        CHECK(part.camera[0].model == all.camera[0].model && part.camera[0].width == 640);
        CHECK(memcmp(part.camera[0].parameter, all.camera[0].parameter, sizeof part.camera[0].parameter) ==
              0);
        CHECK(part.point_count > p.block[b].points);
        CHECK(part.image_count == (size_t)(p.block[b].base_views + p.block[b].border_views));
        for (size_t i = 0; i < part.image_count; i++) {
            export_test_check_image(&all, &seen, &part, &o2, &part.image[i]);
            CHECK((part.image[i].id - 100) / 7 % 8 != 0); /* no test view */
        }
        for (size_t i = 0, k = 0; i < all.point_count; i++)
            if (partition_starts_from(&p, b, i))
                CHECK(export_test_is_point(&all, &part, &o2, &part.point[k++], &all.point[i]));
        colmap_observed_free(&o2);
        colmap_free(test_ctx, &part);
    }
    CHECK(test_has("out/partition.txt") && test_has("out/partition.svg"));
    colmap_observed_free(&seen);
    colmap_free(test_ctx, &all);
}

/* Numbers of the blocks of binary files are those of the text, bit by bit. */
TEST(partition_export_of_a_binary_survey_says_the_same)
{
    OWNED_SCENE *scene = partition_test_reef_scene(2);
    oxl_scene_options options = oxl_scene_options_default();
    struct colmap c, part;
    OWNED_PARTITION p, q;
    char binary[300];
    options.read_images = 0;
    CHECK_OK(colmap_read(test_ctx, test_path("reef/sparse/0"), &c));
    snprintf(binary, sizeof binary, "%s", test_path("reef_binary"));
    test_make_folder("reef_binary/sparse");
    binary_write(test_path("reef_binary/sparse"), &c, test_path("reef/sparse/0"));
    colmap_free(test_ctx, &c);
    p = partition_test_cut(scene, 600, OXL_CUT_BALANCED);
    CHECK_OK(partition_export(test_ctx, &p, test_path("text")));
    oxl_scene_free(test_ctx, scene);
    scene = test_load(binary, &options);
    q = partition_test_cut(scene, 600, OXL_CUT_BALANCED);
    CHECK_OK(partition_export(test_ctx, &q, test_path("binary")));
    CHECK(q.block_count >= 3);
    for (int b = 0; b < q.block_count; b++) {
        CHECK_OK(colmap_read(test_ctx, export_test_folder("text", b), &c));
        CHECK_OK(colmap_read(test_ctx, export_test_folder("binary", b), &part));
        CHECK(part.format == COLMAP_TEXT && part.warnings == 0 && part.image[0].points_size > 0 &&
              colmap_same(&c, &part));
        colmap_free(test_ctx, &c);
        colmap_free(test_ctx, &part);
    }
}

TEST(partition_links_images_and_refuses_to_leave_blocks_of_an_earlier_one)
{
    oxl_job_options options = oxl_job_options_default(OXL_PRESET_DRAFT);
    oxl_partition_report report;
    test_make_folder("reef/images/dive1");
    test_make_folder("reef/masks");
    oxl_scene_free(test_ctx, partition_test_reef_scene(2));
    options.scene.read_images = 0;
    options.partition.blocks = 5;
    CHECK_OK(oxl_partition(test_ctx, test_path("reef"), test_path("out"), &options, &report));
    CHECK(report.block_count == 5 && report.block[0].memory > 1e6);
    oxl_partition_report_free(test_ctx, &report);
#ifndef _WIN32
    CHECK(os_is_folder(test_path("out/blocks/004/images/dive1")) &&
          os_is_folder(test_path("out/blocks/004/masks")));
#endif
    options.partition.blocks = 2;
    CHECK_ERROR(oxl_partition(test_ctx, test_path("reef"), test_path("out"), &options, NULL), OXL_ERR_INPUT,
                "blocks/002/sparse belongs to an earlier partition");
}

TEST(partition_drawing_shows_both_sides_of_a_3d_survey_and_holds_numbers_alone)
{
    for (int flat = 0; flat < 2; flat++) {
        OWNED_SCENE *scene = partition_test_reef_scene(flat ? 2 : 30);
        OWNED_PARTITION p = partition_test_cut(scene, 300, OXL_CUT_BALANCED);
        int boxes = 0;
        CHECK_OK(partition_draw(test_ctx, &p, test_path("a.svg")));
        OWNED_FILE file = test_file("a.svg");
        CHECK(strncmp(file.data, "<svg xmlns=", 11) == 0 && file.size < 500000 && file.size > 10000);
        for (const char *at = file.data; (at = strstr(at, "<rect x='")); at++) boxes++;
        CHECK(boxes == p.block_count * (flat ? 1 : 2));
        CHECK(!strstr(file.data, "nan") && !strstr(file.data, "inf "));
    }
}

TEST(partition_that_cannot_be_written_is_an_error_and_leaves_no_list)
{
    OWNED_SCENE *scene = partition_test_reef_scene(2);
    OWNED_PARTITION p = partition_test_cut(scene, 600, OXL_CUT_BALANCED);
    CHECK_OK(partition_export(test_ctx, &p, test_path("out")));
    CHECK(remove(test_path("out/blocks/001/sparse/0/images.txt")) == 0);
    test_write("out/blocks/001/sparse/0/images.txt/in_the_way", "");
    CHECK_ERROR(partition_export(test_ctx, &p, test_path("out")), OXL_ERR_IO,
                "blocks/001/sparse/0/images.txt");
    CHECK(!test_has("out/partition.txt"));
}
