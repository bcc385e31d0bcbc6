/* number.c - converts decimal text to numbers and back, independent of the locale and correctly rounded.
 *
 * A decimal number is w x 10^e with an integer w. If w <= 2^53 and |e| <= 22, both are doubles without
 * error, so one division or product rounds once (Clinger 1990). Otherwise strtod reads text without a
 * decimal point, which is the same in every locale.
 *
 * Invariant: equal to strtod in the "C" locale; hexadecimal numbers and leading blanks are not accepted.
 */
#include "core.h"

static int number_is_digit(char c)
{
    return (unsigned char)(c - '0') < 10;
}

/* ---------------- integers */

static int number_fits(const char *digits, const char *end, uint64_t limit)
{
    uint64_t w = 0;
    for (; digits < end; digits++) {
        const uint64_t digit = (uint64_t)(*digits - '0');
        if (w > (limit - digit) / 10) return 0;
        w = 10 * w + digit;
    }
    return 1;
}

OXL_INTERNAL int parse_int64(const char **cursor, const char *end, int64_t *out)
{
    const char *p = *cursor, *first;
    const int negative = p < end && *p == '-';
    uint64_t w = 0;
    if (p < end && (*p == '-' || *p == '+')) p++;
    for (first = p; p < end && number_is_digit(*p); p++) w = 10 * w + (uint64_t)(*p - '0');
    if (p == first) return 0;
    if (p - first > 18 && !number_fits(first, p, (uint64_t)INT64_MAX + (uint64_t)negative)) return 0;
    /* Avoids -INT64_MIN, which int64_t does not hold. */
    *out = negative && w > 0 ? -(int64_t)(w - 1) - 1 : (int64_t)w;
    *cursor = p;
    return 1;
}

/* ---------------- w x 10^e to the nearest double */

enum {
    NUMBER_DIGITS_MAX = 19, /* digits that always fit into 64 bits */
    /* digits that are kept: a midpoint between two doubles has at most 767, and
     * further digits only break ties */
    NUMBER_DIGITS_KEPT = 800,
    NUMBER_POWER10_MAX = 22 /* exponent of the last power of 10 that is a double */
};

OXL_INTERNAL const double number_power10[NUMBER_POWER10_MAX + 1] = {
    1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
    1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

/* Parses by the C library: (digits .. end as one integer) x 10^exponent. Skips a
 * decimal point among the digits. */
static double number_by_strtod(const char *digits, const char *end, int64_t exponent)
{
    char text[NUMBER_DIGITS_KEPT + 32];
    size_t size = 0;
    int sticky = 0;
    for (; digits < end; digits++) {
        if (*digits == '.' || (size == 0 && *digits == '0')) continue;
        if (size < NUMBER_DIGITS_KEPT) {
            text[size++] = *digits;
        } else {
            sticky |= *digits != '0';
            exponent++;
        }
    }
    if (size == 0) return 0;
    if (sticky) {
        text[size++] = '1';
        exponent--;
    }
    /* Limits the exponent: beyond, the result is 0 or infinity. */
    exponent = OXL_CLAMP(exponent, -9999, 9999);
    snprintf(text + size, sizeof text - size, "e%d", (int)exponent);
    return strtod(text, NULL);
}

#ifndef FLT_EVAL_METHOD
#define FLT_EVAL_METHOD -1 /* Stands in where a compiler does not define it. */
#endif

/* w: value of the digits, modulo 2^64 if there are more than NUMBER_DIGITS_MAX. */
static double number_scale(uint64_t w, const char *digits, const char *end, int count, int64_t exponent)
{
    const int64_t size = exponent < 0 ? -exponent : exponent;
    if (count > NUMBER_DIGITS_MAX) return number_by_strtod(digits, end, exponent);
    if (w == 0) return 0;
    if (FLT_EVAL_METHOD == 0 && w <= UINT64_C(1) << 53 && size <= NUMBER_POWER10_MAX)
        return exponent < 0 ? (double)w / number_power10[size] : (double)w * number_power10[size];
    return number_by_strtod(digits, end, exponent);
}

/* ---------------- the text of a double */

/* Returns the position after `word`, without regard to case; NULL: no match. */
static const char *number_skip_word(const char *p, const char *end, const char *word)
{
    for (; *word; word++, p++)
        if (p == end || (*p | 0x20) != *word) return NULL;
    return p;
}

/* Parses nan, nan(...), inf and infinity. */
static const char *number_parse_name(const char *p, const char *end, double *out)
{
    const char *past = number_skip_word(p, end, "nan");
    *out = NAN;
    if (past) {
        p = past;
        if (p < end && *p == '(') {
            while (p < end && *p != ')') p++;
            if (p < end) past = p + 1;
        }
        return past;
    }
    *out = INFINITY;
    past = number_skip_word(p, end, "infinity");
    return past ? past : number_skip_word(p, end, "inf");
}

/* Parses an exponent at the 'e' at p; returns p if no digit follows. */
static const char *number_parse_exponent(const char *p, const char *end, int64_t *exponent)
{
    const char *digit = p + 1;
    int negative = 0;
    int64_t value = 0;
    if (digit < end && (*digit == '-' || *digit == '+')) negative = *digit++ == '-';
    if (digit == end || !number_is_digit(*digit)) return p;
    for (; digit < end && number_is_digit(*digit); digit++)
        if (value < INT64_MAX / 100) value = 10 * value + (*digit - '0');
    *exponent += negative ? -value : value;
    return digit;
}

/* Counts digits without leading zeros and point, up to one more than NUMBER_DIGITS_MAX. */
static int number_significant(const char *digits, const char *end)
{
    ptrdiff_t point = 0;
    while (digits < end && (*digits == '0' || *digits == '.')) digits++;
    for (const char *p = digits; p < end && point == 0; p++) point = *p == '.';
    return (int)OXL_MIN(end - digits - point, NUMBER_DIGITS_MAX + 1);
}

OXL_INTERNAL int parse_double(const char **cursor, const char *end, double *out)
{
    const char *p = *cursor, *first, *last;
    int negative = 0;
    uint64_t w = 0;
    int64_t exponent = 0;
    ptrdiff_t digits;
    double value = 0;
    if (p < end && (*p == '-' || *p == '+')) negative = *p++ == '-';
    for (first = p; p < end && number_is_digit(*p); p++) w = 10 * w + (uint64_t)(*p - '0');
    digits = p - first;
    if (p < end && *p == '.') {
        const char *fraction = ++p;
        for (; p < end && number_is_digit(*p); p++) w = 10 * w + (uint64_t)(*p - '0');
        exponent = fraction - p;
        digits += p - fraction;
    }
    last = p;
    if (digits == 0) {
        p = number_parse_name(first, end, &value);
        if (!p) return 0;
    } else {
        if (p < end && (*p | 0x20) == 'e') p = number_parse_exponent(p, end, &exponent);
        if (digits > NUMBER_DIGITS_MAX) digits = number_significant(first, last);
        value = number_scale(w, first, last, (int)digits, exponent);
    }
    *out = negative ? -value : value;
    *cursor = p;
    return 1;
}

/* ---------------- a double to text */

/* Replaces the locale's decimal point, which may have several bytes. */
static void number_unlocalize(char *text)
{
    char *to = text;
    for (const char *p = text; *p; p++) {
        if (number_is_digit(*p) || *p == '-' || *p == '+' || ((*p | 0x20) >= 'a' && (*p | 0x20) <= 'z'))
            *to++ = *p;
        else if (to == text || to[-1] != '.') *to++ = '.';
    }
    *to = 0;
}

static void format_digits(char out[NUMBER_TEXT_MAX], double value, int precision)
{
    snprintf(out, NUMBER_TEXT_MAX, "%.*g", precision, value);
    number_unlocalize(out);
}

OXL_INTERNAL size_t format_double(char out[NUMBER_TEXT_MAX], double value)
{
    format_digits(out, value, 17);
    return strlen(out);
}

/* Writes with the fewest digits, from `least` on, that parse to the same value, or to the same float. */
static const char *number_shortest(char out[NUMBER_TEXT_MAX], double value, int least, int is_float)
{
    for (int precision = least; precision <= 17; precision++) {
        const char *cursor = out;
        double read = 0;
        format_digits(out, value, precision);
        parse_double(&cursor, out + strlen(out), &read);
        if (is_float ? (float)read == (float)value : read == value) break;
    }
    return out;
}

/* Writes whole numbers without an exponent. */
static void number_format(char out[NUMBER_TEXT_MAX], double value, int is_float)
{
    if (fabs(value) < 1e15 && value == floor(value)) snprintf(out, NUMBER_TEXT_MAX, "%.0f", value + 0.0);
    else number_shortest(out, value, 1, is_float);
}

OXL_INTERNAL void format_shortest(char out[NUMBER_TEXT_MAX], double value)
{
    number_format(out, value, 0);
}

OXL_INTERNAL void format_float(char out[NUMBER_TEXT_MAX], float value)
{
    number_format(out, (double)value, 1);
}

OXL_INTERNAL const char *number_text(char out[NUMBER_TEXT_MAX], double value)
{
    return fabs(value) <= DBL_MAX ? number_shortest(out, value, 6, 0) : "null";
}
