/* oracle.c - one scene of an independent float64 implementation, drawn and differentiated by our kernels.
 *
 *     build/oracle [--double] SCENE.txt OUT.txt
 *
 * reads the oracle's text scene (image, intrinsics, pose, background, sh_degree, near, loss, gaussians; see make oracle in the Makefile)
 * and writes "@name rows cols" sections: image, T_final, dL_dimage, loss and grad_*. --double takes the same kernels in double.
 * In a scene with "clamp_grad ste" the oracle lets the gradient pass the clamp of alpha at 0.99, as CUDA codes do; ours stops there. Then
 * the only gradient that can be the same is the colour's: grad_sh.
 */
#include "../oceanxl.c"
#include "oracle_scene.c"

static void oracle_image(FILE *f, const char *name, const double *rgb, int width, int height)
{
    const size_t pixels = (size_t)width * (size_t)height;
    fprintf(f, "@%s %d %d\n", name, height, 3 * width);
    for (size_t i = 0; i < pixels; i++)
        for (size_t c = 0; c < 3; c++)
            fprintf(f, "%.9g%c", rgb[c * pixels + i], (i + 1) % (size_t)width == 0 && c == 2 ? '\n' : ' ');
}

static void oracle_planes(FILE *f, const char *name, double *const *plane, int first, int count, int rows)
{
    fprintf(f, "@%s %d %d\n", name, rows, count);
    for (int i = 0; i < rows; i++)
        for (int k = 0; k < count; k++) fprintf(f, "%.9g%c", plane[first + k][i], k + 1 < count ? ' ' : '\n');
}

int main(int argc, char **argv)
{
    const int           in_double = argc > 1 && !strcmp(argv[1], "--double");
    oxl_context        *ctx       = NULL;
    struct oracle_scene s;
    struct reference    r;
    double             *drgb, loss;
    FILE               *out;
    if (argc != 3 + in_double) oracle_quit("usage: oracle [--double] SCENE.txt OUT.txt", "");
    if (oxl_context_create(NULL, &ctx) != OXL_OK) oracle_quit("no memory", "");
    s = oracle_read(argv[1 + in_double]);
    oracle_run(ctx, &s, in_double, &r, &drgb, &loss);
    out = fopen(argv[2 + in_double], "wb");
    if (!out) oracle_quit("cannot write", argv[2 + in_double]);
    oracle_image(out, "image", r.rgb, s.width, s.height);
    fprintf(out, "@T_final %d %d\n", s.height, s.width);
    for (int i = 0; i < s.width * s.height; i++) fprintf(out, "%.9g%c", r.transmittance[i], (i + 1) % s.width ? ' ' : '\n');
    fprintf(out, "@loss 1 1\n%.9g\n", loss);
    oracle_image(out, "dL_dimage", drgb, s.width, s.height);
    if (!s.ste) {
        oracle_planes(out, "grad_mean", r.gradient.plane, OXL_MEAN, 3, s.count);
        oracle_planes(out, "grad_quat", r.gradient.plane, OXL_ROTATION, 4, s.count);
        oracle_planes(out, "grad_log_scale", r.gradient.plane, OXL_LOG_SCALE, 3, s.count);
        oracle_planes(out, "grad_logit_o", r.gradient.plane, OXL_OPACITY, 1, s.count);
        oracle_planes(out, "grad_dog", r.gradient.plane, OXL_LOBE, 4, s.count);
    }
    oracle_planes(out, "grad_sh", r.gradient.plane, OXL_SH, oracle_row_size(&s) - 16, s.count);
    fclose(out);
    reference_free(ctx, &r);
    oracle_scene_free(&s);
    free(drgb);
    oxl_context_free(ctx);
    return 0;
}
