/* log.c - writes log lines to the caller, and those of all levels into the context's notes for run.json. */
#include "core.h"

OXL_INTERNAL void oxl_log(oxl_context *ctx, oxl_log_level level, const char *format, ...)
{
    static const char *const levels[] = {"error", "warning", "info", "debug"};
    char line[1024];
    va_list args;
    if (!ctx->options.log && !ctx->notes) return;
    va_start(args, format);
    vsnprintf(line, sizeof line, format, args);
    va_end(args);
    context_name_fields(ctx, line, sizeof line);
    if (ctx->notes) {
        text_add(ctx->notes, "%s\n    {\"level\": \"%s\", \"text\": ", ctx->notes->size ? "," : "",
                 levels[level]);
        text_add_json_string(ctx->notes, line);
        text_add(ctx->notes, "}");
    }
    if (ctx->options.log) ctx->options.log(ctx->options.user, level, line);
}
