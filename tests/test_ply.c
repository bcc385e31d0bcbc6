/* test_ply.c - the PLY reader: each format, each type, and files that lie. */
#include "test.h"

struct ply_test_file {
    unsigned char bytes[8192];
    size_t size;
    int big_endian;
};

static void ply_test_text(struct ply_test_file *f, const char *text)
{
    f->size += (size_t)sprintf((char *)f->bytes + f->size, "%s", text);
}

static void ply_test_put(struct ply_test_file *f, const void *value, int size)
{
    for (int i = 0; i < size; i++)
        f->bytes[f->size++] = ((const unsigned char *)value)[f->big_endian ? size - 1 - i : i];
}
#define PLY_TEST_PUT(f, type, value) ply_test_put(f, &(type){value}, sizeof(type))

static struct ply_test_file ply_test_binary(int big_endian, const char *header)
{
    struct ply_test_file f = {.big_endian = big_endian};
    ply_test_text(&f, big_endian ? "ply\nformat binary_big_endian 1.0\n"
                                 : "ply\nformat binary_little_endian 1.0\n");
    ply_test_text(&f, header);
    return f;
}

static const char *ply_test_save(const char *name, const struct ply_test_file *f)
{
    const char *path = test_path(name);
    test_write_bytes(path, f->bytes, f->size);
    return path;
}

static void ply_test_close(struct ply *ply)
{
    ply_close(test_ctx, ply);
}
#define OWNED_PLY __attribute__((cleanup(ply_test_close))) struct ply

static struct ply ply_test_open(const char *path)
{
    struct ply ply;
    CHECK_OK(ply_open(test_ctx, path, &ply));
    return ply;
}

/* The file is refused, and the message holds the words. */
static void ply_test_refused(const char *text, const char *words)
{
    struct ply ply;
    CHECK_ERROR(ply_open(test_ctx, test_write("bad.ply", text), &ply), OXL_ERR_INPUT, words);
    CHECK(ply.element == NULL && ply.path == NULL);
}

#define PLY_TEST_TYPES                                                                                           \
    "element vertex 2\nproperty char a\nproperty uint8 b\nproperty int16 c\nproperty ushort d\nproperty int e\n" \
    "property uint32 f\nproperty float g\nproperty float64 h\nend_header\n"

/* Two rows of the eight types at the ends of their ranges. */
static void ply_test_check_types(const char *path)
{
    static const double wanted[8][2] = {{-128, 127},
                                        {255, 0},
                                        {-32768, 32767},
                                        {65535, 1},
                                        {-2147483647 - 1, 2147483647},
                                        {4294967295.0, 7},
                                        {-1.5, 0.100000001490116119384765625},
                                        {0.1, -1e300}};
    double got[8][2];
    const float tenth = 0.1f; /* stored: some compilers keep the constant itself wider */
    float as_float[2];
    struct ply_target target[8] = {{0}};
    OWNED_PLY ply = ply_test_open(path);
    CHECK(ply.elements == 1 && ply.element[0].properties == 8 && ply.element[0].rows == 2);
    for (int c = 0; c < 8; c++) target[c].as_double = got[c];
    target[6].as_float = as_float;
    CHECK_OK(ply_read(test_ctx, &ply, 0, target));
    CHECK(!memcmp(got, wanted, sizeof got) && as_float[0] == -1.5f && as_float[1] == tenth);
}

TEST(ply_binary_files_of_both_endians_give_each_type_exactly)
{
    for (int big_endian = 0; big_endian < 2; big_endian++) {
        struct ply_test_file f = ply_test_binary(big_endian, PLY_TEST_TYPES);
        for (int row = 0; row < 2; row++) {
            PLY_TEST_PUT(&f, int8_t, row ? 127 : -128);
            PLY_TEST_PUT(&f, uint8_t, row ? 0 : 255);
            PLY_TEST_PUT(&f, int16_t, row ? 32767 : -32768);
            PLY_TEST_PUT(&f, uint16_t, row ? 1 : 65535);
            PLY_TEST_PUT(&f, int32_t, row ? 2147483647 : -2147483647 - 1);
            PLY_TEST_PUT(&f, uint32_t, row ? 7 : 0xffffffffu);
            PLY_TEST_PUT(&f, float, row ? 0.1f : -1.5f);
            PLY_TEST_PUT(&f, double, row ? -1e300 : 0.1);
        }
        ply_test_check_types(ply_test_save("types.ply", &f));
    }
}

TEST(ply_ascii_files_give_each_type_exactly_with_any_blanks_and_line_ends)
{
    ply_test_check_types(test_write("types.ply",
                                    "ply\nformat ascii 1.0\n" PLY_TEST_TYPES
                                    "-128 255 -32768 65535 -2147483648 4294967295 -1.5 0.1\n"
                                    "127 0 32767 1 2147483647 7 0.100000001490116119384765625 -1e300"));
    ply_test_check_types(
        test_write("types.ply", "ply\r\nformat ascii 1.0\r\nobj_info what others write\r\n\r\n" PLY_TEST_TYPES
                                "\t-128  255 -32768 65535 -2147483648 4294967295 -1.5 0.1 \r\n\r\n"
                                "127 0 32767 1 2147483647 7 0.100000001490116119384765625 -1e300\r\n"));
}

TEST(ply_ascii_file_of_the_fewest_bytes_is_read_and_one_byte_less_is_refused)
{
    float x[2] = {0};
    struct ply_target target = {.as_float = x};
    OWNED_PLY ply = ply_test_open(
        test_write("least.ply", "ply\nformat ascii 1.0\nelement v 2\nproperty int x\nend_header\n1\n2"));
    if (ply.elements == 1) CHECK_OK(ply_read(test_ctx, &ply, 0, &target));
    CHECK(x[0] == 1 && x[1] == 2);
    ply_test_refused("ply\nformat ascii 1.0\nelement v 2\nproperty int x\nend_header\n1\n",
                     "at least 4 bytes; the file has 2");
}

TEST(ply_of_comments_nothing_is_parsed)
{
    OWNED_PLY ply = ply_test_open(test_write(
        "c.ply",
        "ply\r\ncomment before  the format \r\nformat ascii 1.0\r\ncomment\r\ncomment element vertex 5\r\n"
        "end_header\r\n"));
    CHECK(ply.elements == 0);
}

/* A face list stands before the vertices, and a list and a scalar share an element. */
static void ply_test_check_lists(const char *path)
{
    float x[2] = {0}, flag[2] = {0};
    struct ply_target face[2] = {{0}}, vertex[1] = {{.as_float = x}};
    face[1].as_float = flag;
    OWNED_PLY ply = ply_test_open(path);
    CHECK(ply_find_element(&ply, "vertex") == 1 && ply_find_element(&ply, "edge") == -1);
    CHECK(ply_find_property(&ply.element[0], "vertex_indices") == -1 &&
          ply_find_property(&ply.element[0], "flag") == 1);
    CHECK_OK(ply_read(test_ctx, &ply, 1, vertex));
    CHECK_OK(ply_read(test_ctx, &ply, 0, face));
    CHECK(flag[0] == 5 && flag[1] == -6 && x[0] == 0.25f && x[1] == -8);
}

#define PLY_TEST_LISTS \
    "element face 2\nproperty list uchar int vertex_indices\nproperty short flag\nelement vertex 2\nproperty float x\nend_header\n"

TEST(ply_lists_are_stepped_over_in_each_format)
{
    for (int big_endian = 0; big_endian < 2; big_endian++) {
        struct ply_test_file f = ply_test_binary(big_endian, PLY_TEST_LISTS);
        PLY_TEST_PUT(&f, uint8_t, 3);
        for (int i = 0; i < 3; i++) PLY_TEST_PUT(&f, int32_t, 0x01020304);
        PLY_TEST_PUT(&f, int16_t, 5);
        PLY_TEST_PUT(&f, uint8_t, 0);
        PLY_TEST_PUT(&f, int16_t, -6);
        PLY_TEST_PUT(&f, float, 0.25f);
        PLY_TEST_PUT(&f, float, -8);
        ply_test_check_lists(ply_test_save("lists.ply", &f));
    }
    ply_test_check_lists(
        test_write("lists.ply", "ply\nformat ascii 1.0\n" PLY_TEST_LISTS "3 1 2 3 5\n0 -6\n.25\n-8\n"));
}

TEST(ply_headers_that_are_wrong_are_refused_with_file_line_and_what_was_seen)
{
    static const char *const wrong[][2] = {
        {"", "bad.ply:1: found '', expected a PLY file"},
        {"solid cube\n", "bad.ply:1: found 'solid cube', expected a PLY file"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n1\n",
         "bad.ply:5: found '1', expected format, comment"},
        {"ply\nformat ascii 1.0\ncomment no end",
         "bad.ply:3: found 'comment no end', expected more lines: the header has no end_header"},
        {"ply\nend_header\n", "bad.ply:2: found 'end_header', expected a format line"},
        {"ply\nformat binary_middle_endian 1.0\nend_header\n", "binary_middle_endian"},
        {"ply\nformat ascii 2.0\nend_header\n", "bad.ply:2: found 'format ascii 2.0', expected format ascii"},
        {"ply\nformat ascii 1.0\nproperty float x\nend_header\n",
         "expected an element before its properties"},
        {"ply\nformat ascii 1.0\nelement vertex 0\nproperty half x\nend_header\n",
         "bad.ply:4: found 'property half x', expected property TYPE NAME"},
        {"ply\nformat ascii 1.0\nelement vertex 0\nproperty float\nend_header\n",
         "expected property TYPE NAME"},
        {"ply\nformat ascii 1.0\nelement vertex 0\nproperty list float int x\nend_header\n",
         "with a whole number to count"},
        {"ply\nformat ascii 1.0\nelement vertex\nend_header\n", "expected element NAME COUNT"},
        {"ply\nformat ascii 1.0\nelement vertex -1\nend_header\n", "expected element NAME COUNT"},
        {"ply\nformat ascii 1.0\nelement vertex 1e6\nend_header\n", "expected element NAME COUNT"},
        {"ply\nformat ascii 1.0\nelement vertex 99999999999999999999999\nend_header\n",
         "the count 0 to 9223372036854775807"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float "
         "a234567890b234567890c234567890d234567890e234567890f234567890g234\nend_header\n",
         "less than 64 letters"},
    };
    for (size_t i = 0; i < OXL_COUNT(wrong); i++) ply_test_refused(wrong[i][0], wrong[i][1]);
}

TEST(ply_counts_are_compared_with_the_bytes_before_any_memory_is_taken)
{
    ply_test_refused(
        "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nproperty float x\nproperty double y\n"
        "end_header\n12345678",
        "element vertex announces 1000000000000 rows, which take at least 12000000000000 bytes; the file has 8");
    ply_test_refused(
        "ply\nformat binary_little_endian 1.0\nelement vertex 9223372036854775807\nproperty double x\nend_header\n12345678",
        "announces 9223372036854775807 rows");
    ply_test_refused(
        "ply\nformat ascii 1.0\nelement vertex 1000000000000\nproperty float x\nend_header\n1\n2\n",
        "the file has 4");
    ply_test_refused(
        "ply\nformat binary_little_endian 1.0\nelement a 1\nproperty double x\nelement b 1\nproperty double x\nend_header\n"
        "123456789012345",
        "element b announces 1 rows, which take at least 16 bytes; the file has 15");
}

TEST(ply_rows_without_properties_cost_nothing_however_many)
{
    OWNED_PLY ply = ply_test_open(test_write(
        "empty.ply", "ply\nformat binary_big_endian 1.0\nelement vertex 9223372036854775807\nend_header\n"));
    if (ply.elements == 1) CHECK_OK(ply_read(test_ctx, &ply, 0, NULL));
}

static void ply_test_data_refused(const char *path, const char *words)
{
    static float room[64];
    struct ply_target target[8];
    for (int i = 0; i < 8; i++) target[i] = (struct ply_target){.as_float = room};
    OWNED_PLY ply = ply_test_open(path);
    CHECK(ply.elements > 0 && ply_read(test_ctx, &ply, ply.elements - 1, target) == OXL_ERR_INPUT);
    CHECK_SAYS(words);
}

TEST(ply_data_that_end_early_or_are_no_numbers_are_refused_with_their_place)
{
    static const char ascii[] =
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nend_header\n";
    static const char *const wrong[][2] = {
        {"1 2\n3 abc\n", "d.ply:8: row 1 of 2 of element vertex: found 'abc', expected a number"},
        {"1\n2 3 4\n", "d.ply:7: row 0 of 2 of element vertex"},
        {"1 2 3\n4 5\n", "d.ply:7: row 0 of 2 of element vertex: found '3', expected the end of the line"},
        {"1.00000 2\n", "d.ply:8: row 1 of 2 of element vertex: found '', expected a number"}};
    char text[256];
    for (size_t i = 0; i < OXL_COUNT(wrong); i++) {
        snprintf(text, sizeof text, "%s%s", ascii, wrong[i][0]);
        ply_test_data_refused(test_write("d.ply", text), wrong[i][1]);
    }
    for (int i = 0; i < 2; i++) {
        snprintf(text, sizeof text,
                 "ply\nformat ascii 1.0\nelement f 1\nproperty list int int i\nend_header\n%d 2 3\n",
                 i ? 900000000 : -1);
        ply_test_data_refused(test_write("d.ply", text), "a list that fits");
    }
    struct ply_test_file f = ply_test_binary(0, PLY_TEST_LISTS);
    PLY_TEST_PUT(&f, uint8_t, 255);
    for (int i = 0; i < 30; i++) PLY_TEST_PUT(&f, uint8_t, 0);
    ply_test_data_refused(ply_test_save("d.ply", &f), "row 0 of 2 of element face: found 'the end");
    f.size -= 31;
    PLY_TEST_PUT(&f, uint8_t, 4); /* the lists are whole, but leave too little for the vertices */
    for (int i = 0; i < 25; i++) PLY_TEST_PUT(&f, uint8_t, 0);
    ply_test_data_refused(ply_test_save("d.ply", &f), "of element vertex");
}
