#include "printable.h"

#include <stdbool.h>
#include <stdint.h>

/* Decodes the UTF-8 character at `c`: returns its length in bytes and writes its code point to `number`. For an invalid, incomplete or overlong
   character, returns 1 and writes UINT32_MAX. */
static int read_character(const unsigned char *c, uint32_t *number) {
    static const uint32_t least[] = {0, 0, 0x80, 0x800, 0x10000};
    int length = *c < 0x80 ? 1 : *c >> 5 == 6 ? 2 : *c >> 4 == 14 ? 3 : *c >> 3 == 30 ? 4 : 0;
    *number = length == 1 ? *c : length ? *c & (0xffu >> (length + 1)) : UINT32_MAX;
    for (int i = 1; i < length; i++) {
        if (c[i] >> 6 != 2) length = 0; /* also rejects the terminating NUL */
        else *number = *number << 6 | (c[i] & 0x3fu);
    }
    if (length && *number >= least[length]) return length;
    *number = UINT32_MAX;
    return 1;
}

static bool is_within(uint32_t number, uint32_t first, uint32_t last) { return number >= first && number <= last; }

static bool is_printable(uint32_t n) {
    bool control = n < 0x20 || is_within(n, 0x7f, 0x9f), surrogate = is_within(n, 0xd800, 0xdfff);
    bool order = is_within(n, 0x200b, 0x200f) || is_within(n, 0x2028, 0x202e) || is_within(n, 0x2066, 0x2069) || n == 0x61c || n == 0xfeff;
    return !control && !surrogate && !order && n <= 0x10ffff;
}

void make_printable(char *text) {
    while (*text) {
        uint32_t number;
        int length = read_character((const unsigned char *)text, &number);
        bool good = is_printable(number);
        for (; length > 0; length--, text++)
            if (!good) *text = '?';
    }
}
