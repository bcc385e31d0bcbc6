/* checksum.c - computes checksums of working files, so that files which a disk's fault or another program has
 * changed are not used.
 *
 * Fowler, Noll & Vo's FNV-1a, by words of eight bytes, low byte first, the rest by bytes. It finds accidents,
 * not forgeries, so readers check ranges, too.
 */
#include "core.h"
#include "bytes.h"

#define CHECKSUM_PRIME UINT64_C(1099511628211)

OXL_INTERNAL uint64_t checksum_add(uint64_t sum, const void *data, size_t size)
{
    const unsigned char *bytes = data;
    for (; size >= 8; bytes += 8, size -= 8) {
        sum = (sum ^ bytes_get(bytes, 8)) * CHECKSUM_PRIME;
        sum ^= sum >> 29;
    }
    for (; size > 0; bytes++, size--) sum = (sum ^ *bytes) * CHECKSUM_PRIME;
    return sum;
}

/* ---------------- of text: its last line */

static const char CHECKSUM_LINE[] = "# checksum ";

OXL_INTERNAL void checksum_end_text(struct text *t)
{
    text_add(t, "%s%016llx\n", CHECKSUM_LINE,
             (unsigned long long)checksum_add(CHECKSUM_SEED, t->data ? t->data : "", t->size));
}

OXL_INTERNAL int checksum_is_wrong(const char *data, size_t size)
{
    char line[48];
    const size_t length = sizeof CHECKSUM_LINE - 1 + 17;
    if (size < length || memcmp(data + size - length, CHECKSUM_LINE, sizeof CHECKSUM_LINE - 1) != 0) return 0;
    snprintf(line, sizeof line, "%s%016llx\n", CHECKSUM_LINE,
             (unsigned long long)checksum_add(CHECKSUM_SEED, data, size - length));
    return memcmp(data + size - length, line, length) != 0;
}
