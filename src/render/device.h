/* device.h - the functions of a device, which render in the place of the CPU. The renderer calls them; a
 * backend provides them. */
#ifndef OXL_DEVICE_H
#define OXL_DEVICE_H

#include "render.h"
#include "../survey/image.h"
#include "../model/model.h"

struct kernel_camera;

/* Each does what the renderer function of the same name does; take_image what renderer_set_image does. */
struct renderer_device {
    oxl_result (*create)(oxl_context *ctx, void **out);
    void (*free)(void *device);
    oxl_result (*forward)(void *device, const oxl_model *model, const oxl_camera *camera,
                          const oxl_render_options *options, const struct kernel_camera *kernel_camera,
                          const oxl_model *surroundings, const struct renderer_settings *settings);
    oxl_result (*image)(void *device, float *rgb);   /* (3,H,W) rendered */
    oxl_result (*depth)(void *device, float *depth); /* (H,W) of it; the image is lost */
    int (*has_image)(const void *device, int view);
    oxl_result (*take_image)(void *device, int view, const struct training_image *image,
                             const struct image_window *window, int halved);
    /* The image of take_image, as (3,H,W) and (H,W); returns its number of pixels, 0 on failure. rgb NULL:
     * the number only. */
    size_t (*target)(void *device, float *rgb, float *weight, int *masked);
    oxl_result (*loss)(void *device, const float *rgb, const float *weight,
                       const struct renderer_settings *settings, const struct lamp_area *area,
                       float ssim_weight, struct renderer_loss *out);
    /* points: of renderer_set_depths */
    oxl_result (*backward)(void *device, const float *drgb, const struct depth_point *point, int points,
                           double weight);
    oxl_result (*gradient)(void *device, oxl_model *gradient);
    /* Of the last loss and backward; waits. */
    oxl_result (*lamp_gradient)(void *device, double dlamp[LAMP_TERMS]);
    oxl_result (*score)(void *device, const float *drgb, float *score);
    oxl_result (*step)(void *device, struct trained_model *trained, const oxl_adam *adam,
                       struct renderer_nonfinite *out);
    int (*defer)(void *device, int on);
    oxl_result (*report)(void *device, int wait, struct renderer_report *out);
    oxl_result (*observe)(void *device, const struct renderer_sums *sums);
    oxl_result (*download)(void *device, enum renderer_download what);
    oxl_result (*move_rows)(void *device, const struct renderer_move *move, int *moved);
    oxl_result (*send_shape)(void *device, oxl_model *model, int reset_opacity);
    oxl_result (*clear_visible)(void *device);
    oxl_result (*clear_nonfinite)(void *device, struct trained_model *trained,
                                  struct renderer_nonfinite *out);
};

#endif
