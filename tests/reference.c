/* reference.c - the kernels in double, from the same source: real = double and every name suffixed.
 *
 * Include it after oceanxl.c. It gives reference_render, the numerical reference of the tests: no vectors chosen at run time, libm's
 * exp and log, one thread.
 */
#ifndef TEST_REFERENCE_C
#define TEST_REFERENCE_C
#define OXL_REFERENCE
#undef real
#define real double

#define real_sqrt             real_sqrt_f64
#define real_abs              real_abs_f64
#define real_least            real_least_f64
#define muladd                muladd_f64
#define real_exp2             real_exp2_f64
#define real_exp              real_exp_f64
#define real_log2             real_log2_f64
#define vec3                  vec3_f64
#define mat3                  mat3_f64
#define dot3                  dot3_f64
#define cross3                cross3_f64
#define scale3                scale3_f64
#define add3                  add3_f64
#define multiply3             multiply3_f64
#define mat3_times            mat3_times_f64
#define mat3_transposed_times mat3_transposed_times_f64
#define gaussians             gaussians_f64
#define lens                  lens_f64
#define splat                 splat_f64
#define pair                  pair_f64
#define lobe                  lobe_f64
#define bins                  bins_f64

#define project_job                project_job_f64
#define project_forward            project_forward_f64
#define project_forward_body       project_forward_body_f64
#define project_forward_base       project_forward_base_f64
#define project_forward_avx2       project_forward_avx2_f64
#define project_forward_avx512     project_forward_avx512_f64
#define project_backward           project_backward_f64
#define project_backward_body      project_backward_body_f64
#define project_backward_base      project_backward_base_f64
#define project_backward_avx2      project_backward_avx2_f64
#define project_backward_avx512    project_backward_avx512_f64
#define project_geometry           project_geometry_f64
#define project_rotation           project_rotation_f64
#define project_jacobian           project_jacobian_f64
#define project_covariance         project_covariance_f64
#define project_colour             project_colour_f64
#define project_sight              project_sight_f64
#define project_prefetch           project_prefetch_f64
#define project_basis              project_basis_f64
#define project_basis_backward     project_basis_backward_f64
#define project_colour_backward    project_colour_backward_f64
#define project_lanes              project_lanes_f64
#define project_lane               project_lane_f64
#define project_sigmoid            project_sigmoid_f64
#define project_store              project_store_f64
#define project_gradients          project_gradients_f64
#define project_gather             project_gather_f64
#define project_rotation_backward  project_rotation_backward_f64
#define project_jacobian_backward  project_jacobian_backward_f64
#define project_lane_backward      project_lane_backward_f64
#define project_shape              project_shape_f64
#define project_in_view            project_in_view_f64
#define project_place              project_place_f64
#define project_lobe_geometry      project_lobe_geometry_f64
#define project_lobes              project_lobes_f64
#define project_lobe_lanes         project_lobe_lanes_f64
#define project_lobe_lane          project_lobe_lane_f64
#define project_store_lobe         project_store_lobe_f64
#define project_gather_lobes       project_gather_lobes_f64
#define project_pull               project_pull_f64
#define project_length             project_length_f64
#define project_lobe_lane_backward project_lobe_lane_backward_f64
#define SH_0                       SH_0_F64
#define SH_1                       SH_1_F64
#define SH_2XY                     SH_2XY_F64
#define SH_2ZZ                     SH_2ZZ_F64
#define SH_2XX                     SH_2XX_F64
#define SH_3Y                      SH_3Y_F64
#define SH_3XY                     SH_3XY_F64
#define SH_3YZ                     SH_3YZ_F64
#define SH_3ZZ                     SH_3ZZ_F64
#define SH_3XX                     SH_3XX_F64

#define bin_key           bin_key_f64
#define bin_staged        bin_staged_f64
#define bin_scratch       bin_scratch_f64
#define bin_depth_bits    bin_depth_bits_f64
#define bin_popcount16    bin_popcount16_f64
#define bin_collect       bin_collect_f64
#define bin_column        bin_column_f64
#define bin_columns       bin_columns_f64
#define bin_sort          bin_sort_f64
#define bin_box_tiles     bin_box_tiles_f64
#define bin_contour       bin_contour_f64
#define bin_spans         bin_spans_f64
#define bin_block_rows    bin_block_rows_f64
#define bin_footprint     bin_footprint_f64
#define bin_lay_out       bin_lay_out_f64
#define bin_stage         bin_stage_f64
#define bin_scatter_part  bin_scatter_part_f64
#define bin_prefix        bin_prefix_f64
#define bin_order_tiles   bin_order_tiles_f64
#define bin_reserve_tiles bin_reserve_tiles_f64
#define bin_splats        bin_splats_f64
#define bin_part          bin_part_f64
#define bin_stage_body    bin_stage_body_f64
#define bin_stage_base    bin_stage_base_f64
#define bin_stage_avx2    bin_stage_avx2_f64
#define bin_stage_avx512  bin_stage_avx512_f64
#define bin_free          bin_free_f64
#define bin_join          bin_join_f64
#define bin_reshaped      bin_reshaped_f64
#define bin_lobe          bin_lobe_f64
#define bin_room          bin_room_f64

#define raster_job                   raster_job_f64
#define RASTER_X                     RASTER_X_F64
#define RASTER_Y                     RASTER_Y_F64
#define raster_add_lanes             raster_add_lanes_f64
#define raster_alive                 raster_alive_f64
#define raster_at                    raster_at_f64
#define raster_backward              raster_backward_f64
#define raster_backward_tile         raster_backward_tile_f64
#define raster_batch                 raster_batch_f64
#define raster_close                 raster_close_f64
#define raster_collect               raster_collect_f64
#define raster_composite             raster_composite_f64
#define raster_composite_block       raster_composite_block_f64
#define raster_differentiate         raster_differentiate_f64
#define raster_differentiate_block   raster_differentiate_block_f64
#define raster_forward               raster_forward_f64
#define raster_forward_tile          raster_forward_tile_f64
#define raster_give                  raster_give_f64
#define raster_give_nothing          raster_give_nothing_f64
#define raster_go_on                 raster_go_on_f64
#define raster_gradients             raster_gradients_f64
#define raster_lit                   raster_lit_f64
#define raster_load                  raster_load_f64
#define raster_lobe_slot             raster_lobe_slot_f64
#define raster_lobed                 raster_lobed_f64
#define raster_open                  raster_open_f64
#define raster_open_backward         raster_open_backward_f64
#define raster_pixels                raster_pixels_f64
#define raster_score                 raster_score_f64
#define raster_share                 raster_share_f64
#define raster_slopes                raster_slopes_f64
#define raster_splat                 raster_splat_f64
#define raster_square                raster_square_f64
#define raster_store                 raster_store_f64
#define raster_sum                   raster_sum_f64
#define raster_tile                  raster_tile_f64
#define raster_value                 raster_value_f64
#define raster_whole                 raster_whole_f64
#define raster_forward_plain         raster_forward_plain_f64
#define raster_forward_plain_body    raster_forward_plain_body_f64
#define raster_forward_plain_base    raster_forward_plain_base_f64
#define raster_forward_plain_avx2    raster_forward_plain_avx2_f64
#define raster_forward_plain_avx512  raster_forward_plain_avx512_f64
#define raster_forward_lobed         raster_forward_lobed_f64
#define raster_forward_lobed_body    raster_forward_lobed_body_f64
#define raster_forward_lobed_base    raster_forward_lobed_base_f64
#define raster_forward_lobed_avx2    raster_forward_lobed_avx2_f64
#define raster_forward_lobed_avx512  raster_forward_lobed_avx512_f64
#define raster_backward_plain        raster_backward_plain_f64
#define raster_backward_plain_body   raster_backward_plain_body_f64
#define raster_backward_plain_base   raster_backward_plain_base_f64
#define raster_backward_plain_avx2   raster_backward_plain_avx2_f64
#define raster_backward_plain_avx512 raster_backward_plain_avx512_f64
#define raster_backward_lobed        raster_backward_lobed_f64
#define raster_backward_lobed_body   raster_backward_lobed_body_f64
#define raster_backward_lobed_base   raster_backward_lobed_base_f64
#define raster_backward_lobed_avx2   raster_backward_lobed_avx2_f64
#define raster_backward_lobed_avx512 raster_backward_lobed_avx512_f64
#define raster_score_plain           raster_score_plain_f64
#define raster_score_plain_body      raster_score_plain_body_f64
#define raster_score_plain_base      raster_score_plain_base_f64
#define raster_score_plain_avx2      raster_score_plain_avx2_f64
#define raster_score_plain_avx512    raster_score_plain_avx512_f64
#define raster_score_lobed           raster_score_lobed_f64
#define raster_score_lobed_body      raster_score_lobed_body_f64
#define raster_score_lobed_base      raster_score_lobed_base_f64
#define raster_score_lobed_avx2      raster_score_lobed_avx2_f64
#define raster_score_lobed_avx512    raster_score_lobed_avx512_f64

#define loss_job              loss_job_f64
#define loss_value            loss_value_f64
#define loss_scratch          loss_scratch_f64
#define LOSS_WINDOW           LOSS_WINDOW_F64
#define loss_strip            loss_strip_f64
#define loss_strip_body       loss_strip_body_f64
#define loss_strip_base       loss_strip_base_f64
#define loss_strip_avx2       loss_strip_avx2_f64
#define loss_strip_avx512     loss_strip_avx512_f64
#define loss_l1_strip         loss_l1_strip_f64
#define loss_stride           loss_stride_f64
#define loss_scratch_size     loss_scratch_size_f64
#define loss_columns          loss_columns_f64
#define loss_phase            loss_phase_f64
#define loss_rows             loss_rows_f64
#define loss_ring             loss_ring_f64
#define loss_split            loss_split_f64
#define loss_join             loss_join_f64
#define loss_at               loss_at_f64
#define loss_open             loss_open_f64
#define loss_blur_along       loss_blur_along_f64
#define loss_blur_down        loss_blur_down_f64
#define loss_fold             loss_fold_f64
#define loss_map              loss_map_f64
#define loss_window           loss_window_f64
#define loss_sum_lanes        loss_sum_lanes_f64
#define loss_fill_counts      loss_fill_counts_f64
#define loss_take_row         loss_take_row_f64
#define loss_blur_maps        loss_blur_maps_f64
#define loss_differentiate    loss_differentiate_f64
#define loss_return_row       loss_return_row_f64
#define loss_return_nothing   loss_return_nothing_f64
#define loss_blur_derivatives loss_blur_derivatives_f64
#define loss_give_row         loss_give_row_f64
#define loss_whole_along      loss_whole_along_f64
#define loss_whole_down       loss_whole_down_f64
#define loss_whole_windows    loss_whole_windows_f64
#define loss_clear            loss_clear_f64
#define loss_cut              loss_cut_f64
#define loss_add_up           loss_add_up_f64
#define loss_forward_backward loss_forward_backward_f64
#define loss_free             loss_free_f64

#define adam_job         adam_job_f64
#define adam_pack        adam_pack_f64
#define adam_finite      adam_finite_f64
#define adam_prefetch    adam_prefetch_f64
#define adam_step        adam_step_f64
#define adam_step_body   adam_step_body_f64
#define adam_step_base   adam_step_base_f64
#define adam_step_avx2   adam_step_avx2_f64
#define adam_step_avx512 adam_step_avx512_f64

#include "../src/render/kernels.h"
#include "../src/render/project.c"
#include "../src/render/bin.c"
#include "../src/render/raster.c"
#include "../src/render/loss.c"
#include "../src/render/adam.c"

/* One view, forward and, when drgb is not NULL, backward. Everything is allocated with malloc: tests have memory. */
struct reference {
    struct lens      lens;
    struct gaussians in, gradient; /* planes of this struct's own */
    real             background[3];
    struct splat    *splat;
    struct lobe     *lobe;
    uint16_t        *visible;
    real            *rgb, *transmittance, *dmean2d;
    real (*sums)[SPLAT_SUMS];
    struct bins bins;
};

static void *reference_array(size_t count)
{
    void *array = calloc(count + 2 * PACK, sizeof(double));
    if (!array) abort();
    return array;
}

static void reference_create(struct reference *r, size_t count, int sh_degree)
{
    const size_t packs = (count + PACK - 1) / PACK, rows = packs * PACK;
    *r = (struct reference){.in = {.count = count, .sh_degree = sh_degree}, .gradient = {.count = count, .sh_degree = sh_degree}};
    for (int k = 0; k < OXL_SH + 3 * (sh_degree + 1) * (sh_degree + 1); k++) {
        r->in.plane[k]       = reference_array(rows);
        r->gradient.plane[k] = reference_array(rows);
    }
    for (size_t i = count; i < rows; i++) r->in.plane[OXL_ROTATION][i] = 1;
    r->splat          = calloc(rows + 1, sizeof *r->splat);
    r->visible        = calloc(packs + 1, sizeof *r->visible);
    r->dmean2d        = reference_array(rows);
    r->bins.alpha_min = ALPHA_MIN;
    r->bins.cut       = LOG2_255;
    r->bins.packs     = packs;
    r->bins.splat     = r->splat;
    r->bins.visible   = r->visible;
}

/* Rows 0..lobes-1 get a second lobe, of factors 1/2 and 1. */
static void reference_lobes(struct reference *r, size_t lobes)
{
    for (int k = OXL_LOBE; k < OXL_PLANES; k++) {
        r->in.plane[k]       = reference_array(r->bins.packs * PACK);
        r->gradient.plane[k] = reference_array(r->bins.packs * PACK);
    }
    r->lobe     = calloc(lobes + 1, sizeof *r->lobe);
    r->in.lobes = r->gradient.lobes = r->bins.lobes = lobes;
    r->bins.lobe                                    = r->lobe;
}

static void reference_free(oxl_context *ctx, struct reference *r)
{
    for (int k = 0; k < OXL_PLANES; k++) {
        free(r->in.plane[k]);
        free(r->gradient.plane[k]);
    }
    bin_free(ctx, &r->bins);
    free(r->splat);
    free(r->lobe);
    free(r->visible);
    free(r->dmean2d);
    free(r->rgb);
    free(r->transmittance);
    free(r->sums);
}

static struct lens reference_lens(const oxl_camera *c, double near_plane)
{
    struct lens l = {.width      = c->width,
                     .height     = c->height,
                     .fx         = c->fx,
                     .fy         = c->fy,
                     .cx         = c->cx,
                     .cy         = c->cy,
                     .limit_x    = FRUSTUM_CLAMP * c->width / (2 * c->fx),
                     .limit_y    = FRUSTUM_CLAMP * c->height / (2 * c->fy),
                     .near_plane = near_plane,
                     .alpha_min  = ALPHA_MIN,
                     .cut        = LOG2_255};
    double      eye[3];
    camera_position(c, eye);
    l.rotation.x  = vec3(c->rotation[0], c->rotation[1], c->rotation[2]);
    l.rotation.y  = vec3(c->rotation[3], c->rotation[4], c->rotation[5]);
    l.rotation.z  = vec3(c->rotation[6], c->rotation[7], c->rotation[8]);
    l.translation = vec3(c->translation[0], c->translation[1], c->translation[2]);
    l.eye         = vec3(eye[0], eye[1], eye[2]);
    return l;
}

static void reference_forward(oxl_context *ctx, struct reference *r)
{
    const size_t       pixels  = (size_t)r->lens.width * (size_t)r->lens.height;
    struct project_job project = {
        .in = r->in, .lens = &r->lens, .end_pack = r->bins.packs, .splat = r->splat, .lobe = r->lobe, .visible = r->visible};
    struct raster_job raster = {.bins = &r->bins, .width = r->lens.width, .height = r->lens.height};
    if (!r->rgb) r->rgb = reference_array(3 * pixels);
    if (!r->transmittance) r->transmittance = reference_array(pixels);
    raster.rgb           = r->rgb;
    raster.transmittance = r->transmittance;
    memcpy(raster.background, r->background, sizeof raster.background);
    project_forward(ISA_BASE, &project);
    if (bin_splats(ctx, &r->bins, r->lens.width, r->lens.height) != OXL_OK) abort();
    for (raster.tile = 0; raster.tile < r->bins.tiles_x * r->bins.tiles_y; raster.tile++) raster_forward(ISA_BASE, &raster);
}

static void reference_backward(struct reference *r, const double *drgb)
{
    struct project_job project = {
        .in = r->in, .lens = &r->lens, .end_pack = r->bins.packs, .splat = r->splat, .lobe = r->lobe, .visible = r->visible};
    struct raster_job raster = {.bins = &r->bins, .width = r->lens.width, .height = r->lens.height, .drgb = drgb};
    free(r->sums);
    r->sums              = calloc(r->bins.slot_count + 1, sizeof *r->sums);
    raster.rgb           = r->rgb;
    raster.transmittance = r->transmittance;
    raster.sums          = r->sums;
    for (raster.tile = 0; raster.tile < r->bins.tiles_x * r->bins.tiles_y; raster.tile++) raster_backward(ISA_BASE, &raster);
    project.sums    = (const double(*)[SPLAT_SUMS])r->sums;
    project.out     = r->gradient;
    project.dmean2d = r->dmean2d;
    project_backward(ISA_BASE, &project);
}

/* The score of the view drawn last, added to score (count). */
OXL_INTERNAL void reference_score(struct reference *r, const double *drgb, double *score)
{
    struct raster_job raster = {.bins = &r->bins, .width = r->lens.width, .height = r->lens.height, .rgb = r->rgb, .drgb = drgb};
    raster.score             = reference_array(r->bins.slot_count);
    for (raster.tile = 0; raster.tile < r->bins.tiles_x * r->bins.tiles_y; raster.tile++) raster_score(ISA_BASE, &raster);
    for (size_t i = 0; i < r->bins.visible_count; i++) {
        const struct splat *s = &r->splat[r->bins.order[i]];
        for (uint32_t slot = s->first_slot; slot < s->first_slot + s->slots; slot++)
            score[r->bins.order[i]] += raster.score[slot];
    }
    free(raster.score);
}

/* Back to float: who uses the reference from here on says so by the suffix, of types, functions and members alike. */
#undef OXL_REFERENCE
#undef real
#define real float
#undef real_sqrt
#undef real_abs
#undef real_least
#undef muladd
#undef real_exp2
#undef real_exp
#undef real_log2
#undef vec3
#undef mat3
#undef dot3
#undef cross3
#undef scale3
#undef add3
#undef multiply3
#undef mat3_times
#undef mat3_transposed_times
#undef gaussians
#undef lens
#undef splat
#undef pair
#undef lobe
#undef bins
#undef project_job
#undef project_forward
#undef project_forward_body
#undef project_forward_base
#undef project_forward_avx2
#undef project_forward_avx512
#undef project_backward
#undef project_backward_body
#undef project_backward_base
#undef project_backward_avx2
#undef project_backward_avx512
#undef project_geometry
#undef project_rotation
#undef project_jacobian
#undef project_covariance
#undef project_colour
#undef project_sight
#undef project_prefetch
#undef project_basis
#undef project_basis_backward
#undef project_colour_backward
#undef project_lanes
#undef project_lane
#undef project_sigmoid
#undef project_store
#undef project_gradients
#undef project_gather
#undef project_rotation_backward
#undef project_jacobian_backward
#undef project_lane_backward
#undef project_shape
#undef project_in_view
#undef project_place
#undef project_lobe_geometry
#undef project_lobes
#undef project_lobe_lanes
#undef project_lobe_lane
#undef project_store_lobe
#undef project_gather_lobes
#undef project_pull
#undef project_length
#undef project_lobe_lane_backward
#undef SH_0
#undef SH_1
#undef SH_2XY
#undef SH_2ZZ
#undef SH_2XX
#undef SH_3Y
#undef SH_3XY
#undef SH_3YZ
#undef SH_3ZZ
#undef SH_3XX
#undef bin_key
#undef bin_staged
#undef bin_scratch
#undef bin_depth_bits
#undef bin_popcount16
#undef bin_collect
#undef bin_column
#undef bin_columns
#undef bin_sort
#undef bin_box_tiles
#undef bin_contour
#undef bin_spans
#undef bin_block_rows
#undef bin_footprint
#undef bin_lay_out
#undef bin_stage
#undef bin_scatter_part
#undef bin_prefix
#undef bin_order_tiles
#undef bin_reserve_tiles
#undef bin_splats
#undef bin_part
#undef bin_stage_body
#undef bin_stage_base
#undef bin_stage_avx2
#undef bin_stage_avx512
#undef bin_free
#undef bin_join
#undef bin_reshaped
#undef bin_lobe
#undef bin_room
#undef raster_job
#undef RASTER_X
#undef RASTER_Y
#undef raster_add_lanes
#undef raster_alive
#undef raster_at
#undef raster_backward
#undef raster_backward_tile
#undef raster_batch
#undef raster_close
#undef raster_collect
#undef raster_composite
#undef raster_composite_block
#undef raster_differentiate
#undef raster_differentiate_block
#undef raster_forward
#undef raster_forward_tile
#undef raster_give
#undef raster_give_nothing
#undef raster_go_on
#undef raster_gradients
#undef raster_lit
#undef raster_load
#undef raster_lobe_slot
#undef raster_lobed
#undef raster_open
#undef raster_open_backward
#undef raster_pixels
#undef raster_score
#undef raster_share
#undef raster_slopes
#undef raster_splat
#undef raster_square
#undef raster_store
#undef raster_sum
#undef raster_tile
#undef raster_value
#undef raster_whole
#undef raster_forward_plain
#undef raster_forward_plain_body
#undef raster_forward_plain_base
#undef raster_forward_plain_avx2
#undef raster_forward_plain_avx512
#undef raster_forward_lobed
#undef raster_forward_lobed_body
#undef raster_forward_lobed_base
#undef raster_forward_lobed_avx2
#undef raster_forward_lobed_avx512
#undef raster_backward_plain
#undef raster_backward_plain_body
#undef raster_backward_plain_base
#undef raster_backward_plain_avx2
#undef raster_backward_plain_avx512
#undef raster_backward_lobed
#undef raster_backward_lobed_body
#undef raster_backward_lobed_base
#undef raster_backward_lobed_avx2
#undef raster_backward_lobed_avx512
#undef raster_score_plain
#undef raster_score_plain_body
#undef raster_score_plain_base
#undef raster_score_plain_avx2
#undef raster_score_plain_avx512
#undef raster_score_lobed
#undef raster_score_lobed_body
#undef raster_score_lobed_base
#undef raster_score_lobed_avx2
#undef raster_score_lobed_avx512
#undef loss_job
#undef loss_value
#undef loss_scratch
#undef LOSS_WINDOW
#undef loss_strip
#undef loss_strip_body
#undef loss_strip_base
#undef loss_strip_avx2
#undef loss_strip_avx512
#undef loss_stride
#undef loss_scratch_size
#undef loss_columns
#undef loss_phase
#undef loss_rows
#undef loss_ring
#undef loss_split
#undef loss_join
#undef loss_at
#undef loss_open
#undef loss_blur_along
#undef loss_blur_down
#undef loss_fold
#undef loss_map
#undef loss_window
#undef loss_sum_lanes
#undef loss_fill_counts
#undef loss_take_row
#undef loss_blur_maps
#undef loss_differentiate
#undef loss_return_row
#undef loss_return_nothing
#undef loss_blur_derivatives
#undef loss_give_row
#undef loss_whole_along
#undef loss_whole_down
#undef loss_whole_windows
#undef loss_clear
#undef loss_cut
#undef loss_add_up
#undef loss_forward_backward
#undef loss_free
#undef adam_job
#undef adam_pack
#undef adam_finite
#undef adam_prefetch
#undef adam_step
#undef adam_step_body
#undef adam_step_base
#undef adam_step_avx2
#undef adam_step_avx512
#endif
