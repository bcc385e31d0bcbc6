/* test_number.c - parse_double against strtod in the "C" locale, bit for bit; integers; the way back to
 * text. */
#include "test.h"
#include <locale.h>

/* Whole text must be taken; then the bits of both are the same, or both are not-a-number. */
static int number_agrees(const char *text)
{
    const char *cursor = text, *end = text + strlen(text);
    const double wanted = strtod(text, NULL);
    double seen = 0;
    if (parse_double(&cursor, end, &seen) && cursor == end &&
        (memcmp(&seen, &wanted, sizeof seen) == 0 || (seen != seen && wanted != wanted)))
        return 1;
    printf("  \"%.60s\" gave %.17g, strtod %.17g\n", text, seen, wanted);
    return 0;
}

/* What the text, which must be taken whole, is read as. */
static double number_read(const char *text)
{
    const char *cursor = text;
    double value = 0;
    CHECK(parse_double(&cursor, text + strlen(text), &value) && !*cursor);
    return value;
}

static double number_of_bits(uint64_t bits)
{
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Pseudo-random doubles of survey-like sizes (1e-6 .. 1e6) printed with a format. */
static int number_agrees_printed(const char *format)
{
    char text[400];
    for (uint64_t i = 0; i < 100000; i++) {
        const double size = number_power10[random_bits(2, i, 0) % 13] * 1e-6;
        snprintf(text, sizeof text, format, (2 * random_unit(random_bits(1, i, 0)) - 1) * size);
        if (!number_agrees(text)) return 0;
    }
    return 1;
}

TEST(number_numbers_as_colmap_prints_them_are_read_as_strtod_does)
{
    CHECK(number_agrees_printed("%.17g") && number_agrees_printed("%.3f") && number_agrees_printed("%g"));
    CHECK(number_agrees_printed("%.18f") && number_agrees_printed("%.25e"));
}

TEST(number_any_double_printed_with_17_digits_reads_back_exactly)
{
    char text[64];
    for (uint64_t i = 0; i < 200000; i++) {
        const double wanted = number_of_bits(random_bits(3, i, 0));
        double seen = 0;
        const char *cursor = text;
        if (!(fabs(wanted) <= DBL_MAX)) continue;
        snprintf(text, sizeof text, "%.17g", wanted);
        CHECK(parse_double(&cursor, text + strlen(text), &seen) && !*cursor);
        if (memcmp(&seen, &wanted, sizeof seen) != 0) {
            CHECK_CLOSE(seen, wanted, 0);
            return;
        }
    }
}

TEST(number_subnormals_and_huge_exponents_are_read_as_strtod_does)
{
    static const char *const text[] = {"4.9e-324",
                                       "2.4703282292062327e-324",
                                       "2.4703282292062328e-324",
                                       "2.2250738585072011e-308",
                                       "2.2250738585072014e-308",
                                       "1.7976931348623157e308",
                                       "1.7976931348623158e308",
                                       "1.7976931348623159e308",
                                       "1e400",
                                       "-1e400",
                                       "1e-400",
                                       "-1e-400",
                                       "1e999999999999999999999",
                                       "1e-999999999999999999999",
                                       "0e999999999",
                                       "123456789e-330",
                                       "1e23",
                                       "8.5e22",
                                       "9007199254740993",
                                       "9007199254740993.0000000000000000000000000000000000000000001",
                                       "18446744073709551615",
                                       "18446744073709551616",
                                       "9999999999999999999e27",
                                       "9999999999999999999e-27",
                                       "1e27",
                                       "1e-27",
                                       "1e28",
                                       "1e-28",
                                       "7.2057594037927933e16"};
    char buffer[64];
    for (size_t i = 0; i < OXL_COUNT(text); i++) CHECK(number_agrees(text[i]));
    for (uint64_t i = 0; i < 20000; i++) { /* subnormals */
        snprintf(buffer, sizeof buffer, "%.17g", number_of_bits(random_bits(4, i, 0) >> (12 + i % 52)));
        CHECK(number_agrees(buffer));
    }
    /* any mantissa, any exponent: the joints between the three ways */
    for (uint64_t i = 0; i < 100000; i++) {
        snprintf(buffer, sizeof buffer, "%llue%d", (unsigned long long)(random_bits(5, i, 0) >> (i % 64)),
                 (int)(random_bits(6, i, 0) % 81) - 40);
        CHECK(number_agrees(buffer));
    }
}

/* m + 1/2 units in the last place has up to 767 digits; a digit far behind breaks the tie. */
TEST(number_ties_are_broken_by_the_last_of_a_thousand_digits)
{
    char text[1200];
    int size = snprintf(text, sizeof text,
                        "1.00000000000000011102230246251565404236316680908203125"); /* 1 + 2^-53 */
    CHECK(number_agrees(text));
    memset(text + size, '0', 1000);
    text[size + 1000] = 0;
    CHECK(number_agrees(text));
    text[size + 999] = '1';
    CHECK(number_agrees(text));
    for (int i = 0; i < 1000; i++) text[i] = "0.123456789"[i < 2 ? i : 2 + i % 9];
    CHECK(number_agrees(text));
    snprintf(text, sizeof text, "0.%0700d123e%d", 0, 700);
    CHECK(number_agrees(text));
}

TEST(number_all_spellings_of_a_number_are_taken)
{
    static const char *const text[] = {"0",      "-0",
                                       "+1",     ".5",
                                       "-.5",    "5.",
                                       "1e5",    "1E5",
                                       "1e+005", "1.5e-002",
                                       "00012",  "0.0",
                                       "-0.0e7", "0000000000000000000000000.10000000000000000000000000"};
    for (size_t i = 0; i < OXL_COUNT(text); i++) CHECK(number_agrees(text[i]));
}

TEST(number_nan_and_infinity_are_taken_in_every_spelling)
{
    static const char *const nan_text[] = {"nan", "-nan", "NaN", "-nan(ind)", "nan(snan)"};
    static const char *const inf_text[] = {"inf", "INF", "Infinity"};
    for (size_t i = 0; i < OXL_COUNT(nan_text); i++) CHECK(isnan(number_read(nan_text[i])));
    for (size_t i = 0; i < OXL_COUNT(inf_text); i++) CHECK(number_read(inf_text[i]) > DBL_MAX);
    CHECK(number_read("-inf") < -DBL_MAX);
}

TEST(number_other_text_is_refused_and_the_cursor_does_not_move)
{
    static const char *const text[] = {"", "-", "+", ".", "e5", "-e5", "x1", ",5", "--1", "na", "i", " 1"};
    for (size_t i = 0; i < OXL_COUNT(text); i++) {
        const char *cursor = text[i];
        double value = 0;
        int64_t whole = 0;
        CHECK(!parse_double(&cursor, cursor + strlen(cursor), &value) && cursor == text[i]);
        CHECK(!parse_int64(&cursor, cursor + strlen(cursor), &whole) && cursor == text[i]);
    }
}

TEST(number_parsing_stops_where_the_number_ends_and_never_past_the_end)
{
    static const struct {
        const char *text;
        int length, taken;
        double value;
    } row[] = {{"1.5 2", 5, 3, 1.5},  {"1,5", 3, 1, 1},    {"1e", 2, 1, 1},     {"1e+x", 4, 1, 1},
               {"123456", 3, 3, 123}, {"1.25", 3, 3, 1.2}, {"1e55", 3, 3, 1e5}, {"0x10", 4, 1, 0}};
    for (size_t i = 0; i < OXL_COUNT(row); i++) {
        const char *cursor = row[i].text;
        double value = -1;
        CHECK(parse_double(&cursor, cursor + row[i].length, &value));
        CHECK_CLOSE(value, row[i].value, 0);
        CHECK(cursor - row[i].text == row[i].taken);
    }
}

TEST(number_integers_are_taken_up_to_their_limits_and_refused_beyond)
{
    static const char *const good[] = {
        "0", "-1", "+7", "9223372036854775807", "-9223372036854775808", "000000000000000000000012"};
    static const int64_t value[] = {0, -1, 7, INT64_MAX, INT64_MIN, 12};
    static const char *const bad[] = {"9223372036854775808", "-9223372036854775809", "18446744073709551615",
                                      "99999999999999999999999999"};
    int64_t seen = 0;
    for (size_t i = 0; i < OXL_COUNT(good); i++) {
        const char *cursor = good[i];
        CHECK(parse_int64(&cursor, cursor + strlen(cursor), &seen) && !*cursor && seen == value[i]);
    }
    for (size_t i = 0; i < OXL_COUNT(bad); i++) {
        const char *cursor = bad[i];
        CHECK(!parse_int64(&cursor, cursor + strlen(cursor), &seen) && cursor == bad[i]);
    }
}

TEST(number_text_of_a_double_reads_back_exactly)
{
    char text[NUMBER_TEXT_MAX];
    for (uint64_t i = 0; i < 20000; i++) {
        const double wanted = number_of_bits(random_bits(7, i, 0));
        if (!(fabs(wanted) <= DBL_MAX)) continue;
        CHECK(format_double(text, wanted) == strlen(text));
        double seen = number_read(text);
        CHECK(memcmp(&seen, &wanted, sizeof seen) == 0);
    }
}

/* Of the locales with a decimal comma, any that this machine has. */
TEST(number_a_locale_with_decimal_commas_changes_nothing)
{
    static const char *const name[] = {"de_DE.UTF-8", "de_DE.utf8", "fr_FR.UTF-8",
                                       "fr_FR.utf8",  "de_DE",      "German"};
    static const char *const text[] = {"1.5", "0.12345678901234567890123", "1.7976931348623157e308",
                                       "1.5e-310"};
    static const double value[] = {1.5, 0.12345678901234567890123, 1.7976931348623157e308, 1.5e-310};
    const char *set = NULL;
    char written[NUMBER_TEXT_MAX];
    for (size_t i = 0; i < OXL_COUNT(name) && !set; i++) set = setlocale(LC_NUMERIC, name[i]);
    if (!set) SKIP("no locale with a decimal comma is installed");
    for (size_t i = 0; i < OXL_COUNT(text); i++) CHECK_CLOSE(number_read(text[i]), value[i], 0);
    format_double(written, 1.5);
    setlocale(LC_NUMERIC, "C");
    CHECK_TEXT(written, "1.5");
}

/* Plain values, values next to powers of ten, large coordinates, few digits, any bits. */
TEST(number_is_written_as_printf_writes_it)
{
    for (uint64_t i = 0; i < 200000; i++) {
        const uint64_t r = random_bits(3, i, 0);
        char wanted[64], written[NUMBER_TEXT_MAX];
        double v;
        uint64_t bits;
        if (i % 5 == 0) v = 4200000 + 1000 * random_unit(r);
        else if (i % 5 == 1) v = (double)(int64_t)(r % 2000000000) * 1e-6;
        else if (i % 5 == 2) v = 20 * (random_unit(r) - 0.5);
        else v = number_power10[r % 20] * (i % 5 == 3 ? 1e-6 : 1);
        memcpy(&bits, &v, sizeof bits);
        if (i % 5 == 3) bits += (r >> 20) % 9 - 4;
        if (i % 5 == 4) bits = r;
        memcpy(&v, &bits, sizeof v);
        snprintf(wanted, sizeof wanted, "%.17g", v);
        CHECK(format_double(written, v) == strlen(wanted) && strcmp(written, wanted) == 0);
    }
}
