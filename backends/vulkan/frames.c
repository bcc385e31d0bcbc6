/* frames.c - command buffers and their submission, copies between host and device, and what went wrong.
 *
 * Every command has a barrier behind it, so passes see what earlier ones wrote. What the host sends and reads
 * goes through one staging buffer.
 *
 * Invariant: whatever is recorded works on buffers that live until it was submitted and waited for
 * (vulkan_reserve sees to that).
 */
#include "state.h"

/* ---------------- what went wrong */

OXL_INTERNAL const char *vulkan_word(VkResult result)
{
    switch (result) {
    case VK_TIMEOUT: return "it did not answer in time";
    case VK_ERROR_OUT_OF_HOST_MEMORY: return "no host memory";
    case VK_ERROR_OUT_OF_DEVICE_MEMORY: return "no device memory is left";
    case VK_ERROR_TOO_MANY_OBJECTS: return "the driver allows no more allocations";
    case VK_ERROR_DEVICE_LOST: return "the device is lost";
    case VK_ERROR_INITIALIZATION_FAILED: return "it could not be started";
    case VK_ERROR_INCOMPATIBLE_DRIVER: return "no driver";
    default: return "refused";
    }
}

OXL_INTERNAL int vulkan_is_short(VkResult result)
{
    return result == VK_ERROR_OUT_OF_HOST_MEMORY || result == VK_ERROR_OUT_OF_DEVICE_MEMORY ||
           result == VK_ERROR_TOO_MANY_OBJECTS;
}

/* Keeps the first failure. 1: all is well. */
OXL_INTERNAL int vulkan_ok(struct vulkan *v, VkResult result, const char *what)
{
    const char *name = v->properties.deviceName[0] ? v->properties.deviceName : "Vulkan";
    if (result == VK_SUCCESS) return v->rc == OXL_OK;
    if (v->rc == OXL_OK && vulkan_is_short(result))
        v->rc =
            oxl_fail(v->ctx, OXL_ERR_MEMORY,
                     "%s, %s: %s (%d)\nfix: a smaller --max-side, fewer --max-gaussians, or --backend cpu",
                     name, what, vulkan_word(result), (int)result);
    if (v->rc == OXL_OK)
        v->rc = oxl_fail(v->ctx, OXL_ERR_FAILED, "%s, %s: %s (%d)\nfix: --backend cpu", name, what,
                         vulkan_word(result), (int)result);
    return 0;
}

OXL_INTERNAL int vulkan_made(struct vulkan *v, VkResult result, void *handle, size_t size, const char *what)
{
    if (result != VK_SUCCESS) memset(handle, 0, size);
    return vulkan_ok(v, result, what);
}

OXL_INTERNAL int vulkan_may_retry(struct vulkan *v)
{
    if (v->rc != OXL_ERR_MEMORY || v->is_permanent || v->lost) return 0;
    v->rc = OXL_OK;
    return 1;
}

/* ---------------- recording and submitting */

OXL_INTERNAL struct vulkan_frame *vulkan_frame(struct vulkan *v)
{
    return &v->frame[v->at];
}

OXL_INTERNAL int vulkan_record(struct vulkan *v)
{
    const VkCommandBufferBeginInfo begin = {.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO,
                                            .flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT};
    struct vulkan_frame *f = vulkan_frame(v);
    if (v->rc != OXL_OK || v->recording) return v->rc == OXL_OK;
    v->commands = f->command[f->command_at];
    if (!vulkan_ok(v, v->BeginCommandBuffer(v->commands, &begin), "recording")) return 0;
    v->recording = 1;
    v->relied_on = 0;
    if (v->clock && f->command_at == 0)
        v->CmdResetQueryPool(v->commands, v->clock, (uint32_t)v->at * 2 * VULKAN_SETS, 2 * VULKAN_SETS);
    return 1;
}

/* From now on each pass is timed by the device's own clock, into pass_seconds and pass_runs. For the
 * benchmark. Submits what was recorded before: its times were not reset. */
OXL_INTERNAL oxl_result vulkan_measure(struct vulkan *v)
{
    const VkQueryPoolCreateInfo info = {.sType = VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO,
                                        .queryType = VK_QUERY_TYPE_TIMESTAMP,
                                        .queryCount = VULKAN_FRAMES * 2 * VULKAN_SETS};
    if (!v->properties.limits.timestampComputeAndGraphics || v->stamp_mask == 0)
        return oxl_fail(v->ctx, OXL_ERR_FAILED, "%s has no clock", v->properties.deviceName);
    if (!v->clock && vulkan_finish(v) == OXL_OK)
        VULKAN_MADE(v, v->CreateQueryPool(v->device, &info, NULL, &v->clock), v->clock, "a clock");
    return v->rc;
}

OXL_INTERNAL void vulkan_stamp(struct vulkan *v, enum vulkan_pass pass, uint32_t after)
{
    struct vulkan_frame *f = vulkan_frame(v);
    const uint32_t set = (uint32_t)f->sets - 1;
    if (!v->clock) return;
    f->pass_at[set] = (uint8_t)pass;
    v->CmdWriteTimestamp(v->commands, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, v->clock,
                         2 * ((uint32_t)v->at * VULKAN_SETS + set) + after);
}

static void vulkan_read_clock(struct vulkan *v, const struct vulkan_frame *f)
{
    const uint32_t first = (uint32_t)(f - v->frame) * 2 * VULKAN_SETS;
    uint64_t stamp[2 * VULKAN_SETS];
    if (!v->clock || f->sets == 0) return;
    if (v->GetQueryPoolResults(v->device, v->clock, first, 2 * (uint32_t)f->sets, sizeof stamp, stamp,
                               sizeof *stamp,
                               VK_QUERY_RESULT_64_BIT | VK_QUERY_RESULT_WAIT_BIT) != VK_SUCCESS)
        return;
    for (int i = 0; i < f->sets; i++) {
        v->pass_seconds[f->pass_at[i]] += 1e-9 * v->properties.limits.timestampPeriod *
                                          (double)((stamp[2 * i + 1] - stamp[2 * i]) & v->stamp_mask);
        v->pass_runs[f->pass_at[i]]++;
    }
}

/* What was recorded before is done, and seen, before what comes. */
OXL_INTERNAL void vulkan_barrier(struct vulkan *v)
{
    const VkMemoryBarrier barrier = {.sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER,
                                     .srcAccessMask =
                                         VK_ACCESS_SHADER_WRITE_BIT | VK_ACCESS_TRANSFER_WRITE_BIT,
                                     .dstAccessMask = VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT |
                                                      VK_ACCESS_TRANSFER_READ_BIT |
                                                      VK_ACCESS_TRANSFER_WRITE_BIT | VK_ACCESS_HOST_READ_BIT};
    const VkPipelineStageFlags from = VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT;
    v->updates = 0;
    v->barriers++;
    v->CmdPipelineBarrier(v->commands, from, from | VK_PIPELINE_STAGE_HOST_BIT, 0, 1, &barrier, 0, NULL, 0,
                          NULL);
}

static void vulkan_say_lost(struct vulkan *v)
{
    v->rc = oxl_fail(
        v->ctx, OXL_ERR_FAILED,
        "Vulkan, %s: %s (%d)\nfix: run the command again, it continues from the last checkpoint; if that does "
        "not help, a smaller --max-side, or --backend cpu",
        v->properties.deviceName, vulkan_word(v->lost), (int)v->lost);
}

/* The device is abandoned, its objects stay allocated. After a timeout a submission continues, or hangs: its
 * fence, buffers and pools must not be touched, and another wait may not end. A lost device frees nothing
 * either. And where something could not be submitted, what is on the device is not what the host takes it
 * for. Returns 0. */
OXL_INTERNAL int vulkan_give_up(struct vulkan *v, VkResult result)
{
    v->lost = result;
    vulkan_say_lost(v);
    return 0;
}

/* Clears what was submitted in a frame and is complete. */
static void vulkan_clear_frame(struct vulkan *v, struct vulkan_frame *f)
{
    VkResult result = v->ResetCommandPool(v->device, f->command_pool, 0);
    v->ResetDescriptorPool(v->device, f->descriptor_pool, 0);
    if (result == VK_SUCCESS) result = v->ResetFences(v->device, 1, &f->fence);
    if (result != VK_SUCCESS) vulkan_give_up(v, result);
    f->sets = f->command_at = f->under_way = 0;
    f->staged = 0;
}

/* The number of the frame that is recorded. It is v->mark from vulkan_mark to vulkan_clear_frame. */
OXL_INTERNAL uint32_t vulkan_frame_number(const struct vulkan *v)
{
    return v->mark + !v->marked;
}

/* The last command of a frame writes the frame's number where the host sees it: a wait for a lost device may
 * succeed without the work. */
static void vulkan_mark(struct vulkan *v, struct vulkan_frame *f)
{
    const int relied_on = v->relied_on;
    f->mark = ++v->mark;
    v->marked = 1;
    vulkan_fill(v, &v->staging, VULKAN_MARKS + (size_t)(f - v->frame) * sizeof f->mark, sizeof f->mark,
                f->mark);
    v->relied_on = relied_on;
}

static int vulkan_is_done(const struct vulkan *v, const struct vulkan_frame *f)
{
    uint32_t mark;
    memcpy(&mark, v->mapped + VULKAN_MARKS + (size_t)(f - v->frame) * sizeof mark, sizeof mark);
    return mark == f->mark;
}

/* Until the device is done with a frame, each of its submissions within the time limit. A wait that finds no
 * memory is repeated. */
static void vulkan_wait(struct vulkan *v, struct vulkan_frame *f)
{
    const uint64_t submissions = (uint64_t)f->command_at + 1;
    const uint64_t most = v->timeout_ns > UINT64_MAX / submissions ? UINT64_MAX : v->timeout_ns * submissions;
    VkResult result = VK_ERROR_OUT_OF_HOST_MEMORY;
    if (!f->under_way || v->lost) return;
    for (int tries = 0; tries < 3 && vulkan_is_short(result); tries++)
        result = v->WaitForFences(v->device, 1, &f->fence, VK_TRUE, most);
    if (result == VK_SUCCESS && !vulkan_is_done(v, f)) result = VK_ERROR_DEVICE_LOST;
    if (result != VK_SUCCESS) {
        vulkan_give_up(v, result);
        return;
    }
    vulkan_read_clock(v, f);
    vulkan_clear_frame(v, f);
}

/* A command buffer that could not be ended is lost. Where the host relies on nothing in it, that is a lack of
 * memory like others, but for what comes behind it (vulkan.is_permanent); the next one is used, since only
 * the whole pool is reset. */
static int vulkan_fail_end(struct vulkan *v, VkResult result)
{
    const int last = vulkan_frame(v)->command_at + 1 == VULKAN_COMMANDS;
    if (!vulkan_is_short(result) || v->relied_on || v->clock || last) return vulkan_give_up(v, result);
    vulkan_frame(v)->command_at++;
    v->is_permanent = 1;
    return vulkan_ok(v, result, "recording");
}

/* A submission that finds no memory has changed nothing: it is repeated when the other frames have ended,
 * which hold some, and when images that it does not name have left the device. */
static int vulkan_submit(struct vulkan *v, VkFence fence)
{
    const VkSubmitInfo submit = {
        .sType = VK_STRUCTURE_TYPE_SUBMIT_INFO, .commandBufferCount = 1, .pCommandBuffers = &v->commands};
    VkResult result;
    if (v->updates) vulkan_barrier(v);
    v->submissions++;
    v->recording = 0;
    result = v->EndCommandBuffer(v->commands);
    if (result != VK_SUCCESS) return vulkan_fail_end(v, result);
    result = v->QueueSubmit(v->queue, 1, &submit, fence);
    for (int k = 1; k < VULKAN_FRAMES && vulkan_is_short(result); k++)
        vulkan_wait(v, &v->frame[(v->at + k) % VULKAN_FRAMES]);
    if (vulkan_is_short(result) && !v->lost) result = v->QueueSubmit(v->queue, 1, &submit, fence);
    if (vulkan_is_short(result) && !v->lost && v->evict && v->evict(v, vulkan_frame_number(v)) > 0)
        result = v->QueueSubmit(v->queue, 1, &submit, fence);
    if (v->lost) return 0;
    return result == VK_SUCCESS || vulkan_give_up(v, result);
}

/* A fence behind the frame's last submission stands for those before it. */
static void vulkan_submit_frame(struct vulkan *v)
{
    struct vulkan_frame *f = vulkan_frame(v);
    if (f->command_at > 0 && !vulkan_record(v)) vulkan_give_up(v, VK_ERROR_OUT_OF_HOST_MEMORY);
    if (v->recording && !v->lost) vulkan_mark(v, f);
    if (v->recording && !v->lost) f->under_way = vulkan_submit(v, f->fence);
    if (v->marked && !f->under_way) v->mark--;
    v->marked = 0;
}

/* Where the frame's last command buffer could not be ended, an empty one takes the fence: those before it are
 * under way. */
static void vulkan_fence_frame(struct vulkan *v)
{
    oxl_result failed;
    vulkan_submit_frame(v);
    failed = v->rc;
    if (failed == OXL_OK || v->lost) return;
    v->rc = OXL_OK;
    vulkan_submit_frame(v);
    if (v->lost) return;
    if (v->rc == OXL_OK) v->rc = failed;
    else vulkan_give_up(v, VK_ERROR_OUT_OF_HOST_MEMORY);
}

/* What was recorded before a failure is complete, and counts as done: it is submitted all the same. */
OXL_INTERNAL oxl_result vulkan_finish(struct vulkan *v)
{
    const oxl_result before = v->rc;
    if (v->lost) return v->rc;
    v->rc = OXL_OK;
    vulkan_fence_frame(v);
    for (int k = 0, waits = 0; k < VULKAN_FRAMES; k++) {
        struct vulkan_frame *f = &v->frame[(v->at + 1 + k) % VULKAN_FRAMES];
        v->waits += f->under_way && waits++ == 0;
        vulkan_wait(v, f);
    }
    vulkan_frame(v)->staged = 0;
    if (!v->lost && before != OXL_OK) v->rc = before;
    return v->rc;
}

OXL_INTERNAL oxl_result vulkan_next_frame(struct vulkan *v)
{
    if (v->rc == OXL_OK) vulkan_submit_frame(v);
    if (v->rc != OXL_OK) return v->rc;
    v->at = (v->at + 1) % VULKAN_FRAMES;
    v->frame_waits += (size_t)vulkan_frame(v)->under_way;
    vulkan_wait(v, vulkan_frame(v));
    return v->rc;
}

/* Where the frame has no command buffer left, its last one takes the fence, and the other frame continues. */
OXL_INTERNAL void vulkan_flush(struct vulkan *v)
{
    struct vulkan_frame *f = vulkan_frame(v);
    if (v->rc != OXL_OK || !v->recording) return;
    if (f->command_at + 1 == VULKAN_COMMANDS) vulkan_next_frame(v);
    else if (vulkan_submit(v, VK_NULL_HANDLE)) f->command_at++;
}

OXL_INTERNAL void vulkan_enter(struct vulkan *v)
{
    if (v->rc == OXL_OK) return;
    v->reads = 0;
    vulkan_finish(v);
    v->is_permanent = 0;
    if (v->lost) vulkan_say_lost(v);
    else v->rc = OXL_OK;
}

OXL_INTERNAL int vulkan_ready(struct vulkan *v)
{
    const int records = vulkan_record(v);
    if (records && v->updates) vulkan_barrier(v);
    return records;
}

/* A place of `size` bytes in the staging buffer for what is recorded next. */
static size_t vulkan_stage(struct vulkan *v, size_t size)
{
    size_t at;
    if (vulkan_frame(v)->staged + size > VULKAN_STAGING) vulkan_finish(v);
    at = vulkan_frame(v)->staged;
    vulkan_frame(v)->staged = (at + size + 15) & ~(size_t)15;
    return (size_t)v->at * VULKAN_STAGING + at;
}

OXL_INTERNAL void vulkan_upload(struct vulkan *v, const struct vulkan_buffer *to, size_t offset,
                                const void *from, size_t size)
{
    v->sent += size;
    for (size_t done = 0, piece; done < size && v->rc == OXL_OK; done += piece) {
        VkBufferCopy copy;
        size_t at;
        piece = OXL_MIN(size - done, (size_t)VULKAN_STAGING);
        at = vulkan_stage(v, piece);
        if (!vulkan_ready(v)) return;
        memcpy(v->mapped + at, (const char *)from + done, piece);
        copy = (VkBufferCopy){at, offset + done, piece};
        v->CmdCopyBuffer(v->commands, v->staging.handle, to->handle, 1, &copy);
        v->relied_on = 1;
        vulkan_barrier(v);
    }
}

OXL_INTERNAL void vulkan_copy(struct vulkan *v, const struct vulkan_buffer *from,
                              const struct vulkan_buffer *to, size_t offset, size_t size)
{
    const VkBufferCopy copy = {0, offset, size};
    if (!vulkan_ready(v)) return;
    v->CmdCopyBuffer(v->commands, from->handle, to->handle, 1, &copy);
    v->relied_on = 1;
    vulkan_barrier(v);
}

/* Waits for all that was recorded, and copies the queued reads. */
OXL_INTERNAL void vulkan_collect(struct vulkan *v)
{
    const int reads = v->reads;
    v->reads = 0;
    if (vulkan_finish(v) != OXL_OK) return;
    for (int i = 0; i < reads; i++) memcpy(v->read[i].to, v->mapped + v->read[i].at, v->read[i].size);
}

/* `to` is filled by vulkan_collect, which must come before anything else is sent: many small pieces, one
 * wait. */
OXL_INTERNAL void vulkan_queue_read(struct vulkan *v, const struct vulkan_buffer *from, size_t offset,
                                    void *to, size_t size)
{
    v->read_bytes += size;
    for (size_t done = 0, piece; done < size && v->rc == OXL_OK; done += piece) {
        VkBufferCopy copy;
        piece = OXL_MIN(size - done, (size_t)VULKAN_STAGING);
        if (vulkan_frame(v)->staged + piece > VULKAN_STAGING || v->reads == VULKAN_READS) vulkan_collect(v);
        if (!vulkan_ready(v)) return;
        copy = (VkBufferCopy){offset + done, vulkan_stage(v, piece), piece};
        v->read[v->reads++] = (struct vulkan_read){(char *)to + done, copy.dstOffset, piece};
        v->CmdCopyBuffer(v->commands, from->handle, v->staging.handle, 1, &copy);
        vulkan_barrier(v);
    }
}

OXL_INTERNAL void vulkan_download(struct vulkan *v, const struct vulkan_buffer *from, size_t offset, void *to,
                                  size_t size)
{
    vulkan_queue_read(v, from, offset, to, size);
    vulkan_collect(v);
}

/* A few words, kept in the command itself. Updates that follow each other have one barrier. */
OXL_INTERNAL void vulkan_update(struct vulkan *v, const struct vulkan_buffer *to, size_t offset,
                                const void *from, size_t size)
{
    if (!vulkan_record(v)) return;
    v->CmdUpdateBuffer(v->commands, to->handle, offset, size, from);
    v->updates = 1;
}

OXL_INTERNAL void vulkan_fill(struct vulkan *v, const struct vulkan_buffer *to, size_t offset, size_t size,
                              uint32_t value)
{
    if (!vulkan_ready(v)) return;
    v->CmdFillBuffer(v->commands, to->handle, offset, size, value);
    v->relied_on = 1;
    vulkan_barrier(v);
}
