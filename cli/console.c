/* console.c - runs a command for the programs oceanxl and oceanxl-lab: reads arguments, writes log lines and
 * progress to standard error, counts and limits memory, handles signals, returns exit codes.
 */
#ifndef _DEFAULT_SOURCE
/* Keeps the handler after the first signal: glibc's signal() in strict C99 would drop it. */
#define _DEFAULT_SOURCE 1
#endif
#include "console.h"

#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#ifdef __GLIBC__
#include <malloc.h>
#include <sys/mman.h>
#endif
#ifdef _WIN32
#include <windows.h>
#include <shellapi.h>
#else
#include <unistd.h>
#endif

/* ---------------- standard error: log lines and the progress */

/* Waits so many seconds between two states of the live line, or two lines of JSON. */
#define LIVE_SECONDS 0.2
/* Waits so many seconds between two lines in a pipe, unless a twentieth of the run ends first. */
#define PLAIN_SECONDS 10.0

enum {
    ALLOCATION_HEAD = 16,        /* bytes before each allocation, which hold its size */
    ALLOCATION_MAPPED = 4 << 20, /* bytes from which glibc maps an allocation by itself */
    ALLOCATION_TRIM = 32 << 20   /* bytes of free memory that glibc keeps at most */
};

static volatile sig_atomic_t stop_requested;
static time_t stop_time;

/* Stops the run; a second Ctrl-C ends the program. One that comes within a second or two is a duplicate:
 * timeout, for example, signals the program and then its group. */
static void on_signal(int number)
{
    const time_t now = time(NULL);
    if (!stop_requested) stop_time = now;
    signal(number, now > stop_time + 1 ? SIG_DFL : on_signal);
    if (now > stop_time + 1) raise(number);
    stop_requested = 1;
}

static int is_stopped(void *user)
{
    (void)user;
    return stop_requested;
}

void console_catch_signals(void)
{
    signal(SIGINT, on_signal);
    signal(SIGTERM, on_signal);
#ifdef SIGBREAK
    signal(SIGBREAK, on_signal); /* Ctrl-Break, and a window that is closed */
#endif
#ifdef SIGHUP
    /* Stops the run when the terminal closes, but not under nohup, which ignores the signal. */
    if (signal(SIGHUP, SIG_IGN) != SIG_IGN) signal(SIGHUP, on_signal);
#endif
#ifdef SIGPIPE
    signal(SIGPIPE, SIG_IGN); /* the reader of a pipe has ended, but training continues */
#endif
}

void console_clear(struct console *c)
{
    if (c->shown) fputs("\r\033[K", stderr);
    c->shown = 0;
}

/* Prints an error, its further lines indented below the first. */
void console_error(const char *kind, const char *text)
{
    fprintf(stderr, "oxl: %s", kind);
    for (size_t size; *text; text += size) {
        const char *end = strchr(text, '\n');
        char line[2048];
        size = end ? (size_t)(end + 1 - text) : strlen(text);
        if (size >= sizeof line) size = sizeof line - 1;
        memcpy(line, text, size);
        line[size] = 0;
        print_text(stderr, line);
        if (end && end < text + size) fputs("     ", stderr);
    }
    fputc('\n', stderr);
}

void console_log(void *user, oxl_log_level level, const char *text)
{
    struct console *c = user;
    if (level > (c->verbose ? OXL_LOG_DEBUG : c->quiet ? OXL_LOG_WARNING : OXL_LOG_INFO)) return;
    if (c->json) {
        fprintf(stderr, "{\"event\": \"log\", \"level\": \"%s\", \"text\": ",
                level == OXL_LOG_DEBUG     ? "debug"
                : level == OXL_LOG_INFO    ? "info"
                : level == OXL_LOG_WARNING ? "warning"
                                           : "error");
        json_print(stderr, text);
        fputs("}\n", stderr);
        return;
    }
    console_clear(c);
    console_error(level == OXL_LOG_WARNING ? "warning: " : "", text);
}

/* Asks for pages of 2 MB where a system gives them on request: a step goes through the planes of a model, of
 * its moments and gradients side by side, which are more pages of 4 KB than a processor keeps translations of.
 * Advises whole pages, as glibc maps them: realloc could not move a mapping of which only a part is advised. */
static void prefer_huge_pages(void *memory, size_t size)
{
#ifdef MADV_HUGEPAGE
    const uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE), start = (uintptr_t)memory & ~(page - 1),
                    end = ((uintptr_t)memory + size + page - 1) & ~(page - 1);
    if (size >= ALLOCATION_MAPPED) madvise((void *)start, end - start, MADV_HUGEPAGE);
#else
    (void)memory;
    (void)size;
#endif
}

/* Counts the library's memory and limits it by --ram. The size of each allocation stands before it, because
 * its owner does not give it back. */
static void *reallocate(void *user, void *old, size_t size)
{
    struct cli_memory *m = &((struct console *)user)->memory;
    size_t *had = old ? (size_t *)((char *)old - ALLOCATION_HEAD) : NULL, *now;
    const size_t before = had ? *had : 0;
    if (size > 0 && m->limit > 0 && size > before && m->used + (size - before) > m->limit) {
        m->refused = 1;
        return NULL;
    }
    if (size > 0 && (size > SIZE_MAX - ALLOCATION_HEAD || !(now = realloc(had, size + ALLOCATION_HEAD))))
        return NULL;
    m->used = m->used - before + size;
    if (m->used > m->peak) m->peak = m->used;
    if (size == 0) {
        free(had);
        return NULL;
    }
    *now = size;
    prefer_huge_pages(now, size + ALLOCATION_HEAD);
    return (char *)now + ALLOCATION_HEAD;
}

static void print_progress(struct console *c, const oxl_progress *p)
{
    static const char *const stages[] = {"block", "coarse", "merged"}; /* enum oxl_stage */
    const double rate =
        (p->iteration - c->iteration) / (p->seconds > c->seconds ? p->seconds - c->seconds : 1e-9);
    const int before = p->iterations > c->planned ? c->planned : 0; /* steps of the run, during those added */
    if (rate > 0) c->rate = c->rate > 0 ? 0.7 * c->rate + 0.3 * rate : rate;
    c->iteration = p->iteration;
    c->seconds = p->seconds;
    if (c->json) {
        fprintf(
            stderr,
            "{\"event\": \"progress\", \"stage\": \"%s\", \"block\": %d, \"blocks\": %d, \"iteration\": %d, \"iterations\": %d, "
            "\"loss\": %.6g, \"psnr\": %.4g, \"gaussians\": %zu, \"seconds\": %.1f, \"seconds_left\": %.1f, \"memory\": %.0f}\n",
            stages[p->stage], p->block, p->blocks, p->iteration, p->iterations, p->loss, p->psnr,
            p->gaussians, p->seconds, p->seconds_left, (double)p->memory);
        fflush(stderr);
        return;
    }
    console_clear(c);
    if (p->stage != OXL_STAGE_BLOCK) fprintf(stderr, "%s model ", stages[p->stage]);
    else if (p->blocks > 1) fprintf(stderr, "block %d/%d ", p->block, p->blocks);
    if (before) fprintf(stderr, "model for other viewers ");
    fprintf(stderr, "%6d/%d", p->iteration - before, p->iterations - before);
    if (p->loss > 0) /* else no step has told it: a stage begins, or a device has the first step still */
        fprintf(stderr, "  loss %.4f  PSNR %.2f dB", p->loss, p->psnr);
    fprintf(stderr, "  %zu Gaussians", p->gaussians);
    if (c->rate > 0) fprintf(stderr, "  %.1f it/s", c->rate);
    fprintf(stderr, "  %.0f MB", (double)p->memory / 1e6);
    if (p->seconds_left > 0 || p->iteration == p->iterations) /* else it is not known */
        fprintf(stderr, "  ETA %s", OUTPUT_SECONDS(p->seconds_left));
    if (!c->live) fputc('\n', stderr);
    c->shown = c->live;
    fflush(stderr);
}

int console_progress(void *user, const oxl_progress *p)
{
    struct console *c = user;
    const int twentieth = (int)(20.0 * p->iteration / (p->iterations > 0 ? p->iterations : 1));
    double since;
    int due;
    if (!c->planned || p->seconds < c->seconds) { /* another block or job has begun */
        c->planned = p->iterations;
        c->iteration = p->iteration;
        c->seconds = p->seconds;
        c->twentieth = 0;
        c->rate = 0;
    }
    since = p->seconds - c->seconds;
    due = c->live || c->json ? since >= LIVE_SECONDS : twentieth > c->twentieth || since >= PLAIN_SECONDS;
    if ((!c->quiet || c->json) && (due || p->iteration == p->iterations)) {
        c->twentieth = twentieth;
        print_progress(c, p);
    }
    return stop_requested;
}

int console_count(void *user, const char *what, long done, long total)
{
    struct console *c = user;
    const int twentieth = (int)(20.0 * (double)done / (double)(total > 0 ? total : 1));
    if (!c->quiet && (c->live || twentieth != c->twentieth)) {
        console_clear(c);
        fprintf(stderr, "%s %ld/%ld%s", what, done, total, c->live ? "" : "\n");
        c->shown = c->live;
        fflush(stderr);
    }
    c->twentieth = twentieth;
    return stop_requested;
}

/* ---------------- in and out */

static int exit_code_of(oxl_result rc)
{
    switch (rc) {
    case OXL_OK: return EXIT_DONE;
    case OXL_ERR_USAGE: return EXIT_USAGE;
    case OXL_ERR_INPUT: return EXIT_INPUT;
    case OXL_ERR_BUDGET: return EXIT_BUDGET;
    case OXL_ERR_INTERRUPTED: return EXIT_STOPPED;
    default: return EXIT_FAILED;
    }
}

enum { RAM_ADVISED = 64 /* MiB; enough for any small survey, so that the second try succeeds */ };

/* Prints the error; memory that --ram refused is an error of the budget, not of the machine. */
static oxl_result console_fail(struct console *c, oxl_result rc, const char *text)
{
    static const char smaller[] = "smaller --max-side, --max-gaussians or --image-cache";
    const char *fix = strstr(text, "\nfix: ");
    const int over = rc == OXL_ERR_MEMORY && c->memory.refused; /* 1: the fix is a larger --ram */
    const size_t advised = (c->memory.limit >> 19) + 1;         /* MiB; twice the limit */
    char said[1400];
    int used = 0;
    if (over) used = snprintf(said, sizeof said, "--ram allows %.3g MB: ", (double)c->memory.limit / 1e6);
    used += snprintf(said + used, sizeof said - (size_t)used, "%.*s", over && fix ? (int)(fix - text) : 1000,
                     text[0] ? text : "no memory");
    if (rc == OXL_ERR_MEMORY && (over || !fix) && used < (int)sizeof said) {
        if (over)
            snprintf(said + used, sizeof said - (size_t)used, "\nfix: --ram %zuM, or %s",
                     advised > RAM_ADVISED ? advised : RAM_ADVISED, smaller);
        else snprintf(said + used, sizeof said - (size_t)used, "\nfix: %s, or a larger --ram", smaller);
    }
    console_log(c, OXL_LOG_ERROR, said);
    return over ? OXL_ERR_BUDGET : rc;
}

#define SPIN_COUNT "500" /* Lets a waiting thread poll so often before it sleeps (docs/log/SPEED.md). */

/* Makes OpenMP threads that wait for others sleep: on a busy machine, polling makes a run three times as
 * long. The OpenMP runtime reads its settings before main(), so the program executes itself again with
 * OMP_WAIT_POLICY=passive and GOMP_SPINCOUNT. Returns at once where OMP_WAIT_POLICY is set, without OpenMP,
 * or without /proc. */
static void wait_passively(char **argv)
{
#if defined(_OPENMP) && !defined(_WIN32)
    char self[4096];
    const char *wanted = getenv("OMP_WAIT_POLICY"); /* an empty value counts as not set */
    const ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);
    if (length <= 0 || (wanted && *wanted)) return;
    self[length] = 0;
    if (setenv("OMP_WAIT_POLICY", "passive", 1) != 0 || setenv("GOMP_SPINCOUNT", SPIN_COUNT, 0) != 0) return;
    execv(self, argv); /* the call returns only on failure */
#else
    (void)argv;
#endif
}

#ifdef _WIN32
/* Returns the arguments in UTF-8, with / for \\, as paths are everywhere here: main() gets those of the code page. */
static char **utf8_arguments(int *argc)
{
    wchar_t **wide = CommandLineToArgvW(GetCommandLineW(), argc);
    char **argv = calloc((size_t)*argc + 1, sizeof *argv);
    SetConsoleOutputCP(CP_UTF8);
    if (!wide || !argv) exit(EXIT_FAILED);
    for (int i = 0; i < *argc; i++) {
        const int size = WideCharToMultiByte(CP_UTF8, 0, wide[i], -1, NULL, 0, NULL, NULL);
        if (!(argv[i] = malloc((size_t)size))) exit(EXIT_FAILED);
        WideCharToMultiByte(CP_UTF8, 0, wide[i], -1, argv[i], size, NULL, NULL);
        for (char *c = argv[i]; *c; c++)
            if (*c == '\\') *c = '/';
    }
    LocalFree(wide);
    return argv;
}
#endif

/* Turns success into a failure if standard output could not be written. */
static oxl_result console_flush(struct console *console, oxl_result rc)
{
    if ((fflush(stdout) == 0 && !ferror(stdout)) || rc != OXL_OK) return rc;
    console_log(
        console, OXL_LOG_ERROR,
        "standard output could not be written\nfix: check the disk, or the program that reads the output");
    return OXL_ERR_IO;
}

int console_main(int argc, char **argv, const struct program *program)
{
    struct arguments a;
    struct console console = {0};
    int code;
    oxl_context_options options = oxl_context_options_default();
    oxl_context *ctx = NULL;
    oxl_result rc;
#ifdef _WIN32
    argv = utf8_arguments(&argc);
#endif
    if (arguments_parse(argc, argv, &a)) {
        console_error("", a.error);
        return EXIT_USAGE;
    }
    if (a.help) help_print(stdout, a.command, a.help[0] != 0);
    if (a.version) puts("oceanxl " OXL_VERSION);
    if (a.manual) help_manual(stdout);
    if (a.page) help_page(stdout);
    if (a.help || a.version || a.manual || a.page) return exit_code_of(console_flush(&console, OXL_OK));
    code = program->takes(argv, &a);
    if (code >= 0) return code;
    wait_passively(argv);
#ifdef __GLIBC__
    /* Maps large allocations one by one, so that they return to the system when
     * freed: --ram counts on that. */
    mallopt(M_MMAP_THRESHOLD, ALLOCATION_MAPPED);
    mallopt(M_TRIM_THRESHOLD, ALLOCATION_TRIM);
#endif
#ifdef SIGXFSZ
    signal(SIGXFSZ, SIG_IGN); /* a write past ulimit -f then fails, as on a full disk */
#endif
    console.quiet = a.quiet;
    console.verbose = a.verbose;
    console.json = a.progress_json;
    console.live = !console.json && oxl_is_terminal(2);
    options.log = console_log;
    options.stopped = is_stopped;
    options.user = &console;
    options.reallocate = reallocate;
    console.memory.limit = a.job.ram;
    if (a.threads > 0) options.threads = a.threads;
    if (a.job.seed) options.seed = a.job.seed;
    if (a.command != COMMAND_TRAIN && a.command <= COMMAND_SYNTH) a.job.scene.allow_truncated = 1;
    options.backend = (oxl_backend)a.backend;
    options.device = a.device;
    options.device_ram = a.job.device_ram;
    options.command_line = 1;
    rc = oxl_context_create(&options, &ctx);
    if (rc == OXL_OK) rc = oxl_backend_begin(ctx);
    if (rc == OXL_OK) rc = program->run(ctx, &a, &console);
    if (rc == OXL_ERR_INTERRUPTED && (a.command == COMMAND_RENDER || a.command == COMMAND_SYNTH))
        console_error("", "the command was interrupted\nfix: run the same command again");
    if (rc != OXL_OK && rc != OXL_ERR_INTERRUPTED) rc = console_fail(&console, rc, oxl_error_text(ctx));
    oxl_context_free(ctx);
    return exit_code_of(console_flush(&console, rc));
}
