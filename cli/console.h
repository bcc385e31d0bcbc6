/* console.h - runs a program on a console: what main.c and lab/main.c call of console.c. */
#ifndef CONSOLE_H
#define CONSOLE_H

#include "cli.h"

struct console {
    int json;           /* 1: standard error is JSON lines */
    int quiet, verbose; /* verbose: 1: prints OXL_LOG_DEBUG, the evidence of decisions */
    int live;           /* 1: standard error is a terminal, on which one line is rewritten */
    int shown;          /* 1: the live line has no newline yet */
    int twentieth;      /* last twentieth of the run that was shown */
    int planned;   /* steps of the block or job as first reported; the model for other viewers adds some */
    int iteration; /* iteration and seconds at the last line */
    double seconds;
    double rate; /* iterations a second, smoothed over the lines */
    struct cli_memory memory;
};

struct program {
    /* Returns the exit code of a command that another program runs, or -1: this program runs it. */
    int (*takes)(char **argv, const struct arguments *a);
    oxl_result (*run)(oxl_context *ctx, const struct arguments *a, struct console *console);
};

/* Parses the arguments, prints help, or runs the command in a context of its own; returns the exit code. */
int console_main(int argc, char **argv, const struct program *program);

void console_clear(struct console *c); /* erases the live line */
void console_error(const char *kind, const char *text);
void console_log(void *user, oxl_log_level level, const char *text);
void console_catch_signals(void); /* makes the progress functions return 1 after Ctrl-C */
int console_progress(void *user, const oxl_progress *p);
int console_count(void *user, const char *what, long done, long total);

#endif
