/* test_svg.c - numbers and elements of SVG drawings. */
#include "test.h"
#include "../src/formats/svg.h"

TEST(svg_numbers_have_one_decimal_at_most_and_are_always_numbers)
{
    static const struct {
        double px;
        const char *text;
    } cases[] = {{0, "0"},           {-0.04, "0"},        {1.25, "1.3"},
                 {-1.5, "-1.5"},     {-0.3, "-0.3"},      {1120, "1120"},
                 {12.96, "13"},      {1e30, "100000000"}, {-INFINITY, "-100000000"},
                 {NAN, "-100000000"}};
    for (size_t i = 0; i < OXL_COUNT(cases); i++) CHECK(strcmp(PX(cases[i].px), cases[i].text) == 0);
    CHECK(strcmp(SVG_RECTANGLE(1, 2, -3, 4.5, "class='a'"),
                 "<rect x=\"1\" y=\"2\" width=\"0\" height=\"4.5\" class='a'/>\n") == 0);
}

TEST(svg_scale_bar_is_1_2_or_5_times_a_power_of_ten_and_fits)
{
    for (double most = 1e-4; most < 1e6; most *= 1.07) {
        const double length = svg_scale_bar(most);
        CHECK(length <= most && length > 0.399 * most);
        CHECK(!strpbrk(NUMBER(length), "346789e") &&
              strlen(NUMBER(length)) <= 7); /* not 0.020000000000000004 */
    }
    CHECK(svg_scale_bar(0) == 1 && svg_scale_bar(NAN) == 1 && svg_scale_bar(INFINITY) == 1 &&
          svg_scale_bar(5) == 5);
}
