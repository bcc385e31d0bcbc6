/* page.c - writes the course's page: page TEMPLATE WASM COMPILER > index.html, from the repository's root.
 *
 * A line of the template may hold one of these in double braces:
 *     code FILE FUNCTION      the function's source and the comment before it, highlighted, with line numbers
 *     function FILE FUNCTION  a link to the file; fails when the function is not defined there
 *     text FILE               the file as it is (style sheet, script)
 *     exercises FILE          the ten steps with their exercises, see exercises.txt
 *     wasm, compiler          the module in base64; the compiler's version
 */
#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void fail(const char *where, const char *what, const char *fix) {
    fprintf(stderr, "page: %s: %s\nfix: %s\n", where, what, fix);
    exit(1);
}

static char *read_file(const char *path, size_t *size) {
    FILE *f = fopen(path, "rb");
    char *text = NULL;
    size_t room = 0, n = 0;
    if (!f) fail(path, "cannot be read", "run from the repository's root");
    do {
        text = realloc(text, room = 2 * room + 4096);
        if (!text) fail(path, "no memory to read it", "free some");
        n += fread(text + n, 1, room - n - 1, f);
    } while (n == room - 1);
    text[n] = 0;
    fclose(f);
    if (size) *size = n;
    return text;
}

static void put_escaped(int c) {
    if (c == '<') fputs("&lt;", stdout);
    else if (c == '>') fputs("&gt;", stdout);
    else if (c == '&') fputs("&amp;", stdout);
    else putchar(c);
}

/* ---------------------------------------------------------------- code */

/* The line that defines `name`: it begins in the first column, has name( after a space or a star, and does not end in a semicolon. */
static const char *find_function(const char *text, const char *name) {
    const size_t length = strlen(name);
    for (const char *at = strstr(text, name); at; at = strstr(at + 1, name)) {
        const char *line = at, *end = at + strcspn(at, "\n");
        while (line > text && line[-1] != '\n') line--;
        if (at == line || !isalpha((unsigned char)*line) || at[length] != '(' || (at[-1] != ' ' && at[-1] != '*')) continue;
        if (end[-1] == ';' && !memchr(at, '{', (size_t)(end - at))) continue;
        return line;
    }
    return NULL;
}

static int is_keyword(const char *word, size_t n) {
    static const char *const words[] = {"if",     "else", "for",    "while", "return", "continue", "break", "const",    "static",
                                        "struct", "enum", "double", "float", "int",    "void",     "char",  "unsigned", "sizeof"};
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        if (strlen(words[i]) == n && !memcmp(words[i], word, n)) return 1;
    return 0;
}

static void put_code(const char *at, const char *end) {
    while (at < end) {
        size_t n = 1;
        const char *mark = NULL;
        if (!strncmp(at, "/*", 2)) n = (size_t)(strstr(at, "*/") + 2 - at), mark = "i";
        else if (isalpha((unsigned char)*at) || *at == '_') {
            while (isalnum((unsigned char)at[n]) || at[n] == '_') n++;
            if (is_keyword(at, n)) mark = "b";
        }
        if (mark) printf("<%s>", mark);
        for (size_t i = 0; i < n; i++) put_escaped(at[i]);
        if (mark) printf("</%s>", mark);
        at += n;
    }
}

static const char *no_function(const char *name) {
    static char text[200];
    snprintf(text, sizeof text, "defines no function %s", name);
    return text;
}

static void put_function(const char *file, const char *name) {
    char *text = read_file(file, NULL);
    const char *line = find_function(text, name), *end = line, *begin = line;
    int depth = 0, opened = 0, first = 1;
    if (!line) fail(file, no_function(name), "correct examples/course/course.html");
    for (; *end && !(opened && depth == 0); end++) depth += (*end == '{') - (*end == '}'), opened |= *end == '{';
    if (begin - text > 4 && !strncmp(begin - 4, " */\n", 4))
        for (begin -= 4; strncmp(begin, "/*", 2); begin--)
            ;
    for (const char *c = text; c < begin; c++) first += *c == '\n';
    printf("<figure class=code><figcaption><a href=\"../../%s\">%s</a>, line %d: <code>%s</code></figcaption><pre tabindex=0>",
           file, file, first, name);
    put_code(begin, end);
    printf("</pre></figure>");
    free(text);
}

static void put_link(const char *file, const char *name) {
    char *text = read_file(file, NULL);
    if (!find_function(text, name)) fail(file, no_function(name), "correct examples/course/course.html");
    printf("<a href=\"../../%s\"><code>%s</code> in %s</a>", file, name, file);
    free(text);
}

/* ---------------------------------------------------------------- exercises */

/* The link to a test, "FILE NAME"; fails when the file has no such test. */
static void put_test(char *file) {
    char *name = strchr(file, ' '), macro[200];
    if (!name) fail(file, "names no test", "test: FILE NAME");
    *name++ = 0;
    snprintf(macro, sizeof macro, "TEST(%s)", name);
    if (!strstr(read_file(file, NULL), macro)) fail(file, no_function(name), "correct examples/course/exercises.txt");
    printf("<br>This test compares the two: <a href=\"../../%s\"><code>%s</code></a>.</p>", file, name);
}

/* The fast twin of a step, "FILE FUNCTION". */
static void put_kernel(char *file) {
    char *name = strchr(file, ' ');
    if (!name) fail(file, "names no function", "kernel: FILE FUNCTION");
    *name++ = 0;
    printf("<p class=where>Fast: ");
    put_link(file, name);
}

/* One or two functions of splat.c. */
static void put_step_code(const char *names) {
    char name[2][100];
    const int count = sscanf(names, "%99s %99s", name[0], name[1]);
    for (int i = 0; i < count; i++) {
        printf("<details><summary><code>%s</code></summary>", name[i]);
        put_function("reference/splat.c", name[i]);
        printf("</details>");
    }
}

/* Blocks of lines "key: text"; "exercise: N" opens one. The keys at, from and to are for exercises.c and exercises.sh. */
static void put_exercises(const char *file) {
    char *text = read_file(file, NULL);
    int open = 0;
    for (char *line = strtok(text, "\n"); line; line = strtok(NULL, "\n")) {
        static const char *const keys[][3] = {{"title", "<h3>", "</h3>"},
                                              {"about", "<p>", "</p>"},
                                              {"change", "<p><b>Change.</b> ", "</p>"},
                                              {"predict", "<p><b>Predict.</b> ", "</p>"},
                                              {"observe", "<details><summary>Result</summary><p>", "</p>"},
                                              {"picture", "<p><b>Picture.</b> ", "</p></details>"}};
        char *value = strstr(line, ": ");
        int number;
        if (line[0] == '#' || !value) continue;
        *value = 0, value += 2;
        if (!strcmp(line, "exercise") && (number = atoi(value)) > 0) {
            printf("%s<li id=exercise-%d>", open ? "</li>\n" : "", number);
            open = 1;
        }
        if (!strcmp(line, "in")) put_step_code(value);
        if (!strcmp(line, "kernel")) put_kernel(value);
        if (!strcmp(line, "test")) put_test(value);
        for (size_t k = 0; k < sizeof keys / sizeof *keys; k++)
            if (!strcmp(line, keys[k][0])) {
                int in_code = 0;
                fputs(keys[k][1], stdout);
                for (const char *c = value; *c; c++)
                    if (*c == '`') fputs((in_code = !in_code) ? "<code>" : "</code>", stdout);
                    else put_escaped(*c);
                fputs(keys[k][2], stdout);
            }
    }
    if (open) printf("</li>");
    free(text);
}

static void put_base64(const char *path) {
    static const char digit[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    size_t n;
    unsigned char *b = (unsigned char *)read_file(path, &n);
    for (size_t i = 0; i < n; i += 3) {
        const unsigned long bits = (unsigned long)b[i] << 16 | (i + 1 < n ? b[i + 1] : 0UL) << 8 | (i + 2 < n ? b[i + 2] : 0UL);
        putchar(digit[bits >> 18]);
        putchar(digit[bits >> 12 & 63]);
        putchar(i + 1 < n ? digit[bits >> 6 & 63] : '=');
        putchar(i + 2 < n ? digit[bits & 63] : '=');
    }
    free(b);
}

int main(int argc, char **argv) {
    char *at;
    if (argc != 4) fail("arguments", "three are expected", "page TEMPLATE WASM COMPILER > index.html");
    at = read_file(argv[1], NULL);
    for (char *open; (open = strstr(at, "{{"));) {
        char *close = strstr(open, "}}"), word[3][120] = {"", "", ""};
        if (!close) fail(argv[1], "{{ without }}", "close it");
        *close = 0;
        fwrite(at, 1, (size_t)(open - at), stdout);
        sscanf(open + 2, "%119s %119s %119s", word[0], word[1], word[2]);
        if (!strcmp(word[0], "code")) put_function(word[1], word[2]);
        else if (!strcmp(word[0], "function")) put_link(word[1], word[2]);
        else if (!strcmp(word[0], "text")) fputs(read_file(word[1], NULL), stdout);
        else if (!strcmp(word[0], "exercises")) put_exercises(word[1]);
        else if (!strcmp(word[0], "wasm")) put_base64(argv[2]);
        else if (!strcmp(word[0], "compiler")) fputs(argv[3], stdout);
        else fail(argv[1], open, "see the top of page.c for the words in {{ }}");
        at = close + 2;
    }
    fputs(at, stdout);
    return fflush(stdout) != 0 || ferror(stdout);
}
