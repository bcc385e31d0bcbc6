/* numbers.c - compares the page with the native build: reads what the page wrote for #numbers (course.js, examine()) from stdin.
 *
 *     call NAME in...     the native function is called with the same in[]
 *     out ...             out[] of the page, and
 *     field K ...         every K-th element of field[]: equal to the native ones within 1e-9, relative above 1
 *     shown I DIGITS TEXT what the page displays of out[I]: the native number at that many digits
 *     frame CHAPTER MS    the shortest frame; a note where it exceeds 16 ms, for a busy machine is no error
 *
 * Built twice (make course-check): with math/math.h, as the page; and with the system's libm (COURSE_LIBM), which leaves out what follows a
 * training step. Adam divides a gradient by its own size: where the gradient is rounding alone, the last bit decides on the direction.
 */
#include "course.c"

#ifdef COURSE_LIBM
#define SKIPS(chapter) (!strcmp(chapter, "fit") || !strcmp(chapter, "density"))
#else
#define SKIPS(chapter) 0
#endif

#define TOLERANCE 1e-9
#define FRAME     16.0

static const struct {
    const char *name;
    int (*call)(void);
} COURSE[] = {{"one_gaussian", one_gaussian}, {"compositing", compositing},
              {"gradients", gradients},       {"fit_select", fit_select},
              {"fit_reset", fit_reset},       {"fit_run", fit_run},
              {"fit_densify", fit_densify},   {"fit_show", fit_show},
              {"underwater", underwater},     {"second_lobe", second_lobe},
              {"partition", partition},       {"needle", needle},
              {"summation", summation},       {"growth", growth}};

static long compared, texts, failed;
static double worst;
static char chapter[40] = "?", called[40] = "?";

static void compare(const char *what, int i, double page, double native) {
    const double error = fabs(page - native) / fmax(1, fabs(native));
    compared++;
    if (page == native || (page != page && native != native)) return;
    worst = fmax(worst, error);
    if (error <= TOLERANCE) return;
    if (failed++ < 10)
        printf("FAIL %s, %s: %s[%d] is %.17g on the page, %.17g natively\n", chapter, called, what, i, page, native);
}

/* Half a unit of the last digit that is shown, and the tolerance. */
static void compare_text(int i, const char *digits, const char *shown) {
    const int exponential = *digits == 'e', n = atoi(digits + exponential);
    const double value = !strcmp(shown, "∞") ? HUGE_VAL : strtod(shown, NULL);
    const double unit = exponential && out[i] != 0 ? pow(10, floor(log10(fabs(out[i]))) - n) : pow(10, -n);
    texts++;
    if (value == out[i] || fabs(value - out[i]) <= unit * 0.500001 + TOLERANCE * fmax(1, fabs(out[i]))) return;
    if (failed++ < 10) printf("FAIL %s: the page shows %s for out[%d] = %.17g\n", chapter, shown, i, out[i]);
}

int main(void) {
    enum { LINE = 1 << 20 };
    char *line = malloc(LINE), word[40], digits[16], shown[60];
    int begun = 0, ended = 0, calls = 0, chapters = 0;
    while (line && fgets(line, LINE, stdin)) {
        char *at = line;
        int n = 0, i = 0, stride = 1, end;
        if (!begun || ended) {
            begun |= !strcmp(line, "begin\n");
            continue;
        }
        if (sscanf(at, "%39s%n", word, &n) != 1) continue;
        at += n;
        if (!strcmp(word, "end")) ended = 1;
        else if (!strcmp(word, "chapter")) sscanf(at, "%39s", chapter), chapters++;
        else if (!strcmp(word, "call")) {
            size_t k = 0;
            sscanf(at, "%39s%n", called, &n), at += n, calls++;
            memset(in, 0, sizeof in), memset(field, 0, sizeof field);
            for (; i < 64 && sscanf(at, "%lf%n", &in[i], &n) == 1; i++) at += n;
            while (k < sizeof COURSE / sizeof *COURSE && strcmp(COURSE[k].name, called)) k++;
            if (k == sizeof COURSE / sizeof *COURSE)
                return printf("FAIL the page calls %s, which numbers.c does not know\n", called), 1;
            COURSE[k].call();
        } else if (SKIPS(chapter)) continue;
        else if (!strcmp(word, "out") || !strcmp(word, "field")) {
            const int is_field = *word == 'f';
            const char *name = word;
            if (is_field) stride = (int)strtol(at, &at, 10);
            for (char *next; i * stride < (is_field ? FIELD : OUTPUTS); i++, at = next) {
                const double page = strtod(at, &next);
                if (next == at) break;
                compare(name, i * stride, page, is_field ? field[i * stride] : out[i]);
            }
        } else if (!strcmp(word, "shown") && sscanf(at, "%d %15s %59s", &end, digits, shown) == 3)
            compare_text(end, digits, shown);
        else if (!strcmp(word, "frame") && sscanf(at, "%39s %59s", chapter, shown) == 2) {
            if (SKIPS("fit")) continue;
            printf("frame of %-8s %5s ms\n", chapter, shown);
            if (!(atof(shown) < FRAME)) printf("note: %s: a frame takes %s ms, more than %.0f\n", chapter, shown, FRAME);
        }
    }
    free(line);
    if (!begun || !ended || !texts) return printf("FAIL the page wrote no numbers: an error stopped it\n"), 1;
    printf("%s: %d chapter states, %d calls, %ld numbers, %ld displayed texts; largest difference %.1e\n",
           SKIPS("fit") ? "native with libm" : "native", chapters, calls, compared, texts, worst);
    return failed > 0;
}
