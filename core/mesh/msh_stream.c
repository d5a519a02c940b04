#include "mesh/msh_stream.h"

#include <errno.h>
#include <inttypes.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>

/* ---- failures ---- */

trocar_status msh_fail(msh_stream *s, const char *format, ...) {
    if (s->status != TROCAR_OK) return s->status;
    char what[sizeof s->why->text], place[48] = "";
    va_list arguments;
    va_start(arguments, format);
    decimal_vprint(what, sizeof what, format, arguments);
    va_end(arguments);
    if (!s->converted) snprintf(place, sizeof place, s->binary ? ": byte %" PRIu64 : ":%" PRIu64, s->binary ? (uint64_t)ftello(s->file) : s->word_line);
    return s->status = fail(s->why, TROCAR_BAD_INPUT, "%s%s: %s", s->path, place, what);
}

static void fail_at_end(msh_stream *s) {
    if (ferror(s->file)) msh_fail(s, "cannot read the mesh: %s", strerror(errno));
    else msh_fail(s, "the file ends inside $%s: export the mesh again", s->section);
}

/* ---- text ---- */

static bool is_blank(int c) { return c == ' ' || c == '\t' || c == '\r' || c == '\n' || c == '\f' || c == '\v'; }

static int next_character(msh_stream *s) {
    int c = getc_unlocked(s->file);
    s->line += c == '\n';
    return c;
}

static void put_back(msh_stream *s, int c) {
    s->line -= c == '\n';
    ungetc(c, s->file);
}

/* Reads the next word, up to but not including the blank after it. On failure, which includes the end of the file, the word is "". */
static void read_word(msh_stream *s, char word[MSH_WORD]) {
    int c = ' ', length = 0;
    while (s->status == TROCAR_OK && is_blank(c)) c = next_character(s);
    s->word_line = s->line;
    for (; s->status == TROCAR_OK && c != EOF && !is_blank(c) && length < MSH_WORD - 1; c = next_character(s)) word[length++] = (char)c;
    word[length] = '\0';
    if (c != EOF && length > 0) put_back(s, c);
    if (length == 0) fail_at_end(s);
}

static void skip_line(msh_stream *s) {
    for (int c = 0; s->status == TROCAR_OK && c != '\n' && c != EOF;) c = next_character(s);
}

int64_t msh_text_int(msh_stream *s) {
    char word[MSH_WORD], *end;
    read_word(s, word);
    if (s->status != TROCAR_OK) return 0;
    errno = 0;
    long long number = strtoll(word, &end, 10);
    if (end == word || *end != '\0' || errno != 0) msh_fail(s, "\"%s\" is not a whole number, which $%s needs here: export the mesh again", word, s->section);
    return s->status == TROCAR_OK ? number : 0;
}

int64_t msh_text_int_line(msh_stream *s) {
    int64_t number = msh_text_int(s);
    skip_line(s);
    return number;
}

double msh_text_real(msh_stream *s) {
    char word[MSH_WORD], *end;
    read_word(s, word);
    if (s->status != TROCAR_OK) return 0;
    double number = decimal_read(word, &end);
    if (end == word || *end != '\0') msh_fail(s, "\"%s\" is not a number, which $%s needs here: export the mesh again", word, s->section);
    return number;
}

void msh_quoted(msh_stream *s, char *text, size_t room) {
    size_t length = 0;
    bool inside = false, closed = false;
    for (int c = 0; s->status == TROCAR_OK && c != '\n' && c != EOF;) {
        c = next_character(s);
        if (c == '"') closed = inside, inside = true;
        else if (inside && !closed && c != '\n' && c != '\r' && c != EOF && length + 1 < room) text[length++] = (char)c;
    }
    text[length] = '\0';
}

/* ---- binary ---- */

static void read_bytes(msh_stream *s, void *to, size_t size) {
    unsigned char *bytes = to;
    if (s->status == TROCAR_OK && fread(bytes, 1, size, s->file) != size) fail_at_end(s);
    if (s->status != TROCAR_OK) memset(bytes, 0, size);
    for (size_t i = 0; s->swapped && i < size / 2; i++) {
        unsigned char lower = bytes[i];
        bytes[i] = bytes[size - 1 - i];
        bytes[size - 1 - i] = lower;
    }
}

void msh_byte_order(msh_stream *s) {
    int32_t one;
    s->binary = true;
    read_bytes(s, &one, sizeof one);
    s->swapped = one == 0x01000000;
    if (one != 1 && !s->swapped) msh_fail(s, "the number 1 does not follow the format of a binary file: export the mesh again");
}

int msh_int(msh_stream *s) {
    int32_t number;
    if (s->binary) {
        read_bytes(s, &number, sizeof number);
        return number;
    }
    int64_t wide = msh_text_int(s);
    if (wide < INT_MIN || wide > INT_MAX) msh_fail(s, "%" PRId64 " is too large for $%s: export the mesh again", wide, s->section);
    return s->status == TROCAR_OK ? (int)wide : 0;
}

uint64_t msh_size(msh_stream *s) {
    uint64_t number;
    if (!s->binary) return (uint64_t)msh_text_int(s);
    read_bytes(s, &number, sizeof number);
    return number;
}

double msh_real(msh_stream *s) {
    double number;
    if (!s->binary) return msh_text_real(s);
    read_bytes(s, &number, sizeof number);
    return number;
}

/* ---- sections ---- */

bool msh_next_section(msh_stream *s) {
    while (s->status == TROCAR_OK) {
        int c = next_character(s);
        if (c == EOF && ferror(s->file)) fail_at_end(s);
        if (c == EOF) return false;
        if (c == '$') {
            read_word(s, s->section);
            skip_line(s);
            return s->status == TROCAR_OK;
        }
        if (c != '\n') skip_line(s);
    }
    return false;
}

static bool ends_section(const msh_stream *s, const char *word) { return strncmp(word, "$End", 4) == 0 && strcmp(word + 4, s->section) == 0; }

void msh_end_section(msh_stream *s) {
    char word[MSH_WORD];
    read_word(s, word);
    if (s->status == TROCAR_OK && !ends_section(s, word)) msh_fail(s, "$%s goes on after the number of items that it announces: export the mesh again", s->section);
    skip_line(s);
}

void msh_skip_section(msh_stream *s) {
    for (char word[MSH_WORD] = ""; s->status == TROCAR_OK && !ends_section(s, word);) {
        int c = next_character(s);
        if (c == EOF) fail_at_end(s);
        else if (c == '$') {
            put_back(s, c);
            read_word(s, word);
        }
        if (c != '\n') skip_line(s);
    }
}

bool msh_fits(msh_stream *s, uint64_t count, int numbers, int bytes, const char *items) {
    uint64_t least = s->binary ? (uint64_t)bytes : 2 * (uint64_t)numbers, at = (uint64_t)ftello(s->file);
    if (s->status == TROCAR_OK && (at > s->size || count > (s->size - at + 1) / least))
        msh_fail(s, "$%s announces %" PRIu64 " %s, for which the file is too short: export the mesh again", s->section, count, items);
    return s->status == TROCAR_OK;
}
