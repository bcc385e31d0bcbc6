/* synth_own.c - what synth may replace in OUT: the survey that it wrote there itself, and nobody changed.
 *
 * truth/files.txt lists the files of images/ and sparse/ with their checksums (FNV-1a, by bytes). Until a run
 * is finished the list is a mark without lines: whatever has a name of the run is its own.
 * Invariant: no file is replaced or removed that the list does not have with the sum of its bytes.
 */
#include "synth.h"
#include "../cli/cli.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

#define OWN_LIST "truth/files.txt"
#define OWN_FINISHED "# Written by synth, which replaces them unless they were changed: checksum, file\n"
#define OWN_UNFINISHED "# A run of synth that has not finished\n"

static const char *const own_model[] = {"sparse/0/cameras.txt", "sparse/0/images.txt",
                                        "sparse/0/points3D.txt"};
enum { OWN_MODEL = sizeof own_model / sizeof *own_model };

/* Computes the checksum of a file. 0: it is not there; -1: it is none that can be read. */
static int own_sum(const char *out, const char *name, unsigned long long *sum)
{
    char path[1024];
    unsigned char piece[1 << 14];
    size_t got;
    FILE *file;
    int failed;
    if (snprintf(path, sizeof path, "%s/%s", out, name) >= (int)sizeof path) return -1;
    if (!(file = oxl_open(path))) return errno == ENOENT || errno == ENOTDIR ? 0 : -1;
    *sum = 14695981039346656037ull;
    while ((got = fread(piece, 1, sizeof piece, file)) > 0)
        for (size_t i = 0; i < got; i++) *sum = (*sum ^ piece[i]) * 1099511628211ull;
    failed = ferror(file);
    fclose(file);
    return failed ? -1 : 1;
}

/* Writes the name of file k of the run; returns 0 past the last. */
static int own_name(const synth_options *o, int k, char name[64])
{
    char image[32];
    if (k < OWN_MODEL) snprintf(name, 64, "%s", own_model[k]);
    else if (!o->write_images || k - OWN_MODEL >= o->views) return 0;
    else {
        synth_image_name(o, k - OWN_MODEL, image);
        snprintf(name, 64, "images/%s", image);
    }
    return 1;
}

static oxl_result own_refuse(const struct synth_run *s, const char *name, const char *what)
{
    return oxl_fail(s->ctx, OXL_ERR_USAGE, "%s/%s %s\nfix: another folder by -o, or move this one away",
                    s->options->out, name, what);
}

/* ---------------- the list */

/* Copies the name of a line of the list, and moves on; 0: the last line, or one that no run wrote. */
static int own_line(const char **at, unsigned long long *sum, char name[64])
{
    char *end;
    size_t size;
    *sum = strtoull(*at, &end, 16);
    if (end != *at + 16 || *end != ' ') return 0;
    size = strcspn(++end, "\n");
    if (size >= 64 || end[size] != '\n') return 0;
    memcpy(name, end, size);
    name[size] = 0;
    *at = end + size + 1;
    return !strstr(name, "..") && (!strncmp(name, "images/", 7) || !strncmp(name, "sparse/0/", 9));
}

static int own_is_listed(const char *list, const char *wanted)
{
    unsigned long long sum;
    char name[64];
    while (own_line(&list, &sum, name))
        if (!strcmp(name, wanted)) return 1;
    return 0;
}

/* Returns the lines of the list; "" of a run that did not finish, or of a version without lists; NULL: synth
 * wrote nothing here. Free *memory. */
static const char *own_read(const synth_options *o, char **memory, int *is_finished)
{
    static const char old[] = "A made-up seabed, ";
    *memory = output_read(o->out, OWN_LIST, NULL);
    *is_finished = *memory && !strncmp(*memory, OWN_FINISHED, strlen(OWN_FINISHED));
    if (*is_finished) return *memory + strlen(OWN_FINISHED);
    if (*memory) return strcmp(*memory, OWN_UNFINISHED) ? NULL : "";
    *memory = output_read(o->out, "truth/model.txt", NULL);
    return *memory && !strncmp(*memory, old, strlen(old)) ? "" : NULL;
}

/* ---------------- before a run */

/* Refuses files that were changed after synth wrote them, and those of its names that it did not write. */
static oxl_result own_check_files(const struct synth_run *s, const char *list)
{
    unsigned long long sum, now = 0;
    char name[64];
    for (const char *at = list; own_line(&at, &sum, name);) {
        const int state = own_sum(s->options->out, name, &now);
        if (state < 0 || (state && now != sum))
            return own_refuse(s, name, "was changed after synth wrote it");
    }
    for (int k = 0; own_name(s->options, k, name); k++)
        if (own_sum(s->options->out, name, &now) && !own_is_listed(list, name))
            return own_refuse(s, name, "is not of synth");
    return OXL_OK;
}

/* Refuses a folder with a survey, or a part of one, that synth did not write. */
oxl_result synth_own_check(const struct synth_run *s)
{
    static const char *const others[] = {"transforms.json",    "transforms_train.json", "reconstruction.json",
                                         "cameras.txt",        "cameras.bin",           "sparse/cameras.txt",
                                         "sparse/cameras.bin", "sparse/0/cameras.bin"};
    static const char *const folders[] = {"images", "sparse", "truth"};
    unsigned long long sum;
    char path[1024], *memory;
    int is_finished;
    const char *list;
    oxl_result rc = OXL_OK;
    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        if (own_sum(s->options->out, others[i], &sum))
            return own_refuse(s, others[i], "is of a survey that synth did not write");
    list = own_read(s->options, &memory, &is_finished);
    for (size_t i = 0; rc == OXL_OK && !list && i < sizeof folders / sizeof *folders; i++) {
        snprintf(path, sizeof path, "%s/%s", s->options->out, folders[i]);
        if (oxl_is_folder(path)) rc = own_refuse(s, folders[i], "is there, and synth did not write it");
    }
    if (rc == OXL_OK && is_finished) rc = own_check_files(s, list);
    free(memory);
    return rc;
}

/* Writes the list, or without `of_files` the mark of a run that has not finished. */
static oxl_result own_write(const struct synth_run *s, int of_files)
{
    struct output t = {0};
    unsigned long long sum = 0;
    char name[64], path[1024], text[24];
    snprintf(path, sizeof path, "%s/" OWN_LIST, s->options->out);
    output_add(&t, "%s", of_files ? OWN_FINISHED : OWN_UNFINISHED);
    for (int k = 0; of_files && own_name(s->options, k, name); k++) {
        if (own_sum(s->options->out, name, &sum) <= 0) t.failed = 1;
        snprintf(text, sizeof text, "%016llx", sum);
        output_add(&t, "%s %s\n", text, name);
    }
    return output_save(&t, path)
               ? OXL_OK
               : oxl_fail(s->ctx, OXL_ERR_IO, "synth: cannot write %s\nfix: free space on the disk", path);
}

/* Removes the survey of the run before, as its images would belong to other poses; the mark comes first. */
oxl_result synth_own_begin(const struct synth_run *s)
{
    unsigned long long sum;
    char name[64], path[1024], *memory;
    int is_finished;
    const char *list = own_read(s->options, &memory, &is_finished);
    const oxl_result rc = own_write(s, 0);
    while (rc == OXL_OK && list && own_line(&list, &sum, name)) {
        snprintf(path, sizeof path, "%s/%s", s->options->out, name);
        remove(path);
    }
    free(memory);
    return rc;
}

oxl_result synth_own_finish(const struct synth_run *s)
{
    return own_write(s, 1);
}
