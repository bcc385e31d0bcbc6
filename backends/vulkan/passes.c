/* passes.c - passes: one compute shader over a number of workgroups.
 */
#include "state.h"
#include "generated/spirv.h"

#define VULKAN_PASS(name)                                                                             \
    [PASS_##name] = {SPIRV_##name, sizeof SPIRV_##name, SPIRV_##name##_BINDINGS, SPIRV_##name##_PUSH, \
                     SPIRV_##name##_SHARED}
static const struct {
    const uint32_t *words;
    size_t bytes;
    /* storage buffers, in the shader's order; bytes of push constants; of shared memory */
    uint32_t bindings, push, shared;
} VULKAN_PASSES[PASS_COUNT] = {
    VULKAN_PASS(PROJECT),
    VULKAN_PASS(SCAN),
    VULKAN_PASS(COMPACT),
    VULKAN_PASS(SORT_COUNT),
    VULKAN_PASS(SORT_SCATTER),
    VULKAN_PASS(FOOTPRINT),
    VULKAN_PASS(RANGES),
    VULKAN_PASS(RASTER),
    VULKAN_PASS(RASTER_LOBED),
    VULKAN_PASS(RASTER_BACKWARD),
    VULKAN_PASS(RASTER_BACKWARD_LOBED),
    VULKAN_PASS(LOSS_FORWARD),
    VULKAN_PASS(LOSS_TOTAL),
    VULKAN_PASS(LOSS_BACKWARD),
    VULKAN_PASS(PROJECT_BACKWARD),
    VULKAN_PASS(STEP),
    VULKAN_PASS(OBSERVE),
    VULKAN_PASS(SCORE),
    VULKAN_PASS(UNPACK),
    VULKAN_PASS(MOVE),
    VULKAN_PASS(LAMP),
    VULKAN_PASS(IMAGING_PIXELS),
    VULKAN_PASS(IMAGING_TOTAL),
    VULKAN_PASS(DEPTH_LOSS),
    VULKAN_PASS(PEAK),
};

OXL_INTERNAL size_t vulkan_shared(void)
{
    size_t most = 0;
    for (int pass = 0; pass < PASS_COUNT; pass++) most = OXL_MAX(most, VULKAN_PASSES[pass].shared);
    return most;
}

static void vulkan_make_layout(struct vulkan *v, enum vulkan_pass pass)
{
    struct vulkan_pipeline *p = &v->pipeline[pass];
    VkDescriptorSetLayoutBinding binding[VULKAN_BINDINGS];
    const VkPushConstantRange push = {VK_SHADER_STAGE_COMPUTE_BIT, 0, VULKAN_PASSES[pass].push};
    VkDescriptorSetLayoutCreateInfo set = {.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO,
                                           .bindingCount = VULKAN_PASSES[pass].bindings,
                                           .pBindings = binding};
    const VkPipelineLayoutCreateInfo layout = {.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO,
                                               .setLayoutCount = 1,
                                               .pSetLayouts = &p->set,
                                               .pushConstantRangeCount = 1,
                                               .pPushConstantRanges = &push};
    for (uint32_t i = 0; i < VULKAN_PASSES[pass].bindings; i++)
        binding[i] = (VkDescriptorSetLayoutBinding){i, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1,
                                                    VK_SHADER_STAGE_COMPUTE_BIT, NULL};
    if (p->set ||
        VULKAN_MADE(v, v->CreateDescriptorSetLayout(v->device, &set, NULL, &p->set), p->set, "a layout"))
        VULKAN_MADE(v, v->CreatePipelineLayout(v->device, &layout, NULL, &p->layout), p->layout, "a layout");
}

static void vulkan_make_variant(struct vulkan *v, enum vulkan_pass pass, uint32_t variant)
{
    const VkSpecializationMapEntry entry = {0, 0, sizeof variant};
    const VkSpecializationInfo special = {1, &entry, sizeof variant, &variant};
    const VkShaderModuleCreateInfo code = {.sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO,
                                           .codeSize = VULKAN_PASSES[pass].bytes,
                                           .pCode = VULKAN_PASSES[pass].words};
    VkShaderModule module;
    VkComputePipelineCreateInfo info = {.sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO};
    if (!v->pipeline[pass].layout) vulkan_make_layout(v, pass);
    if (v->rc != OXL_OK || !vulkan_ok(v, v->CreateShaderModule(v->device, &code, NULL, &module), "a shader"))
        return;
    info.layout = v->pipeline[pass].layout;
    info.stage =
        (VkPipelineShaderStageCreateInfo){.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO,
                                          .stage = VK_SHADER_STAGE_COMPUTE_BIT,
                                          .module = module,
                                          .pName = "main",
                                          .pSpecializationInfo = &special};
    vulkan_ok(v,
              v->CreateComputePipelines(v->device, VK_NULL_HANDLE, 1, &info, NULL,
                                        &v->pipeline[pass].variant[variant]),
              "a shader");
    v->DestroyShaderModule(v->device, module, NULL);
}

/* A shader that the driver refuses counts as lack of memory: with --backend auto the CPU takes over. */
OXL_INTERNAL void vulkan_prepare(struct vulkan *v, enum vulkan_pass pass, uint32_t variant)
{
    if (v->rc != OXL_OK || v->pipeline[pass].variant[variant]) return;
    vulkan_make_variant(v, pass, variant);
    if (v->rc == OXL_OK) return;
    v->is_permanent = v->rc != OXL_ERR_MEMORY;
    v->rc = OXL_ERR_MEMORY;
}

/* Shaders are compiled as if no two bindings shared memory, so one buffer must not be bound twice. */
static void vulkan_check_bindings(struct vulkan *v, enum vulkan_pass pass,
                                  const struct vulkan_buffer *const *buffer)
{
    for (uint32_t i = 0; v->validates && i < VULKAN_PASSES[pass].bindings; i++)
        for (uint32_t k = 0; k < i; k++)
            if (buffer[i] && buffer[k] && buffer[i]->handle && buffer[i]->handle == buffer[k]->handle &&
                v->validation_messages++ < 10)
                oxl_log(v->ctx, OXL_LOG_WARNING, "Vulkan: pass %d binds one buffer as %u and %u", (int)pass,
                        k, i);
}

static VkDescriptorSet vulkan_bind(struct vulkan *v, enum vulkan_pass pass,
                                   const struct vulkan_buffer *const *buffer)
{
    const uint32_t count = VULKAN_PASSES[pass].bindings;
    const VkDescriptorSetAllocateInfo info = {.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO,
                                              .descriptorPool = vulkan_frame(v)->descriptor_pool,
                                              .descriptorSetCount = 1,
                                              .pSetLayouts = &v->pipeline[pass].set};
    VkDescriptorSet set = VK_NULL_HANDLE;
    VkDescriptorBufferInfo whole[VULKAN_BINDINGS];
    VkWriteDescriptorSet write = {.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET,
                                  .descriptorCount = count,
                                  .descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER,
                                  .pBufferInfo = whole};
    vulkan_check_bindings(v, pass, buffer);
    if (!vulkan_ok(v, v->AllocateDescriptorSets(v->device, &info, &set), "descriptors"))
        return VK_NULL_HANDLE;
    for (uint32_t i = 0; i < count; i++)
        whole[i] = (VkDescriptorBufferInfo){
            buffer[i] && buffer[i]->handle ? buffer[i]->handle : v->dummy.handle, 0, VK_WHOLE_SIZE};
    write.dstSet = set;
    v->UpdateDescriptorSets(v->device, 1, &write, 0, NULL);
    return set;
}

/* Records a pass of so many workgroups, see VULKAN_RUN. buffer: NULL where the variant uses none. */
OXL_INTERNAL void vulkan_run(struct vulkan *v, enum vulkan_pass pass, uint32_t variant, size_t groups,
                             const void *push, const struct vulkan_buffer *const *buffer)
{
    struct vulkan_pipeline *p = &v->pipeline[pass];
    const size_t across = OXL_MIN(groups, v->groups_max), down = across ? (groups + across - 1) / across : 0;
    VkDescriptorSet set;
    if (v->rc != OXL_OK || groups == 0) return;
    if (vulkan_frame(v)->sets == VULKAN_SETS) vulkan_finish(v);
    if (down > v->groups_max) {
        v->rc =
            oxl_fail(v->ctx, OXL_ERR_FAILED, "%s: %zu workgroups are more than it takes\nfix: --backend cpu",
                     v->properties.deviceName, groups);
        return;
    }
    vulkan_prepare(v, pass, variant);
    if (!vulkan_ready(v)) return;
    set = vulkan_bind(v, pass, buffer);
    if (v->rc != OXL_OK) return;
    vulkan_frame(v)->sets++;
    v->CmdBindPipeline(v->commands, VK_PIPELINE_BIND_POINT_COMPUTE, p->variant[variant]);
    v->CmdBindDescriptorSets(v->commands, VK_PIPELINE_BIND_POINT_COMPUTE, p->layout, 0, 1, &set, 0, NULL);
    v->CmdPushConstants(v->commands, p->layout, VK_SHADER_STAGE_COMPUTE_BIT, 0, VULKAN_PASSES[pass].push,
                        push);
    vulkan_stamp(v, pass, 0);
    v->dispatches++;
    v->relied_on |= pass == PASS_STEP || pass == PASS_OBSERVE || pass == PASS_MOVE || pass == PASS_UNPACK;
    v->CmdDispatch(v->commands, (uint32_t)across, (uint32_t)down, 1);
    vulkan_stamp(v, pass, 1);
    vulkan_barrier(v);
}
