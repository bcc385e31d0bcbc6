/* vulkan_compile.c - makes every pipeline of the Vulkan backend on a device and runs none: for drivers
 * without their GPU.
 *
 *     make VULKAN=1 build/vulkan_compile
 *     RADV_FORCE_FAMILY=navi21 RADV_DEBUG=shaderstats VK_ICD_FILENAMES=.../radeon_icd.x86_64.json
 *     build/vulkan_compile
 *
 * Mesa's RADV compiles for an AMD GPU given by name and prints the resources of each shader (to stderr); a
 * line of ours says which it was.
 */
#include "../oceanxl.c"

#ifndef OXL_VULKAN
int main(void)
{
    fputs("vulkan_compile: built without the Vulkan backend. fix: make VULKAN=1 build/vulkan_compile\n",
          stderr);
    return 1;
}
#else

/* The variants that a pass is run in (renderer.c), bit by bit. */
static unsigned compile_variants(int pass)
{
    if (pass == PASS_SCAN) return 1 | 2 | 4 | 8;
    if (pass == PASS_LOSS_BACKWARD || pass == PASS_PROJECT) return 255;
    if (pass == PASS_STEP) return 1 | 2 | 4;
    if (pass == PASS_PROJECT_BACKWARD) return 1 | 4;
    if (pass == PASS_FOOTPRINT || pass == PASS_LOSS_TOTAL || pass == PASS_LOSS_FORWARD ||
        pass == PASS_OBSERVE || pass == PASS_UNPACK)
        return 1 | 2;
    if (pass == PASS_RASTER || pass == PASS_RASTER_LOBED) return 1 | 2 | 4;
    return pass == PASS_RASTER_BACKWARD || pass == PASS_RASTER_BACKWARD_LOBED ? 1 | 4 : 1;
}

/* Whether the variant is the plain one and a part of training: dropout, medium, lamp. So it has more instructions, or the plain one has them, too. */
static int compile_adds(int pass, uint32_t variant)
{
    if (pass == PASS_PROJECT) return variant & 3;
    if (pass == PASS_STEP || pass == PASS_PROJECT_BACKWARD) return variant == 2;
    return variant == 1 && pass == PASS_LOSS_FORWARD;
}

int main(void)
{
    oxl_context_options options = oxl_context_options_default();
    struct vulkan v = {0};
    uint32_t tried = 0;
    int made = 0;
    if (oxl_context_create(&options, &v.ctx) != OXL_OK) return 1;
    oxl_result rc = vulkan_start(&v);
    if (rc == OXL_OK) rc = vulkan_choose(&v, -1, 1, &tried);
    if (rc == OXL_OK) rc = vulkan_check(&v);
    if (rc == OXL_OK) rc = vulkan_create_device(&v);
    for (int pass = 0; rc == OXL_OK && pass < PASS_COUNT; pass++)
        for (uint32_t k = 0; rc == OXL_OK && k < VULKAN_VARIANTS; k++) {
            if (!(compile_variants(pass) >> k & 1)) continue;
            made++;
            fprintf(stderr, "pass %d, variant %u%s\n", pass, k, compile_adds(pass, k) ? ", with a part" : "");
            vulkan_make_variant(&v, pass, k);
            rc = v.rc;
        }
    if (rc == OXL_OK) printf("%s: %d pipelines\n", v.properties.deviceName, made);
    else fprintf(stderr, "vulkan_compile: %s\n", oxl_error_text(v.ctx));
    fflush(stdout);
    _Exit(rc != OXL_OK); /* drivers without their device do not all end well */
}
#endif
