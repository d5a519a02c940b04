#include "igtl.h"

#include <endian.h>
#include <stdlib.h>
#include <string.h>

#include <igtl_image.h>
#include <igtl_polydata.h>
#include <igtl_string.h>
#include <igtl_transform.h>
#include <igtl_util.h>

enum { ASCII = 3, UTF_8 = 106 }; /* character sets, as numbered by IANA (MIBenum) */
enum { EXTENDED_HEADER = 12, NO_METADATA = 2 /* bytes; metadata without entries is just the number of entries, 0 */ };
static const uint64_t LARGEST_BODY = UINT64_C(1) << 28;

/* ---- values ---- */

void igtl_name(igtl_message *m, const char *type, const char *name) {
    m->type = type;
    strncpy(m->name, name, IGTL_HEADER_NAME_SIZE);
}

static void drop_packets(igtl_message *m) {
    for (int i = 0; i < 2; i++) {
        igtl_drop(m->packets[i]);
        m->packets[i] = NULL;
    }
}

void igtl_free(igtl_message *m) {
    drop_packets(m);
    bytes_free(&m->content);
}

/* Makes the changed content the message's new value. */
static void renew(igtl_message *m, int64_t utime) {
    drop_packets(m);
    m->utime = utime;
    m->number++;
}

void igtl_set_transform(igtl_message *m, int64_t utime, const ras_matrix *matrix) {
    ras_matrix sent = *matrix;
    igtl_transform_convert_byte_order(sent.numbers);
    bytes_clear(&m->content);
    bytes_append(&m->content, &sent, sizeof sent);
    renew(m, utime);
}

void igtl_set_string(igtl_message *m, int64_t utime, const char *text) {
    size_t length = strnlen(text, UINT16_MAX);
    igtl_string_header head = {.encoding = ASCII, .length = (igtl_uint16)length};
    for (size_t i = 0; i < length; i++)
        if (text[i] & 0x80) head.encoding = UTF_8;
    igtl_string_convert_byte_order(&head);
    bytes_clear(&m->content);
    bytes_append(&m->content, &head, sizeof head);
    bytes_append(&m->content, text, length);
    renew(m, utime);
}

void igtl_set_image(igtl_message *m, int64_t utime, const ras_matrix *matrix, int width, int height, const unsigned char *grey) {
    igtl_image_header head = {.version = IGTL_IMAGE_HEADER_VERSION, .num_components = 1, .scalar_type = IGTL_IMAGE_STYPE_TYPE_UINT8,
                              .endian = IGTL_IMAGE_ENDIAN_LITTLE, .coord = IGTL_IMAGE_COORD_RAS};
    const igtl_uint16 size[3] = {(igtl_uint16)width, (igtl_uint16)height, 1};
    memcpy(head.size, size, sizeof size);
    memcpy(head.subvol_size, size, sizeof size);
    memcpy(head.matrix, matrix->numbers, sizeof head.matrix);
    igtl_image_convert_byte_order(&head);
    size_t pixels = (size_t)width * (size_t)height;
    bool same = m->content.length == sizeof head + pixels && memcmp(m->content.data, &head, sizeof head) == 0
             && memcmp(m->content.data + sizeof head, grey, pixels) == 0;
    if (same) return;
    bytes_clear(&m->content);
    bytes_append(&m->content, &head, sizeof head);
    bytes_append(&m->content, grey, pixels);
    renew(m, utime);
}

static bool make_polydata(igtl_message *m, igtl_polydata_info *info) {
    size_t size = (size_t)igtl_polydata_get_size(info, IGTL_TYPE_PREFIX_NONE);
    info->points = calloc(info->header.npoints + 1, 3 * sizeof *info->points);
    unsigned char *bytes = malloc(size);
    bool made = info->points && bytes && igtl_polydata_pack(info, bytes, IGTL_TYPE_PREFIX_NONE) == 1;
    if (made) bytes_append(&m->content, bytes, size);
    free(info->points);
    free(bytes);
    return made && !m->content.failed;
}

bool igtl_make_surface(igtl_message *m, int points, int triangles, uint32_t *polygons) {
    igtl_polydata_info info = {.header = {.npoints = (igtl_uint32)points, .npolygons = (igtl_uint32)triangles, .size_polygons = (igtl_uint32)(16 * triangles)},
                               .polygons = polygons};
    return make_polydata(m, &info);
}

bool igtl_make_curve(igtl_message *m, int points) {
    igtl_uint32 line[1 + TROCAR_MAX_JOINTS] = {(igtl_uint32)points};
    for (int i = 0; i < points; i++) line[1 + i] = (igtl_uint32)i;
    igtl_polydata_info info = {.header = {.npoints = (igtl_uint32)points, .nlines = 1, .size_lines = (igtl_uint32)(4 * (1 + points))}, .lines = line};
    return make_polydata(m, &info);
}

void igtl_move_points(igtl_message *m, int64_t utime, const float *points, int count) {
    unsigned char *sent = m->content.data + sizeof(igtl_polydata_header);
    bool moved = m->number == 0;
    for (int i = 0; i < 3 * count; i++) {
        uint32_t bits;
        memcpy(&bits, points + i, sizeof bits);
        bits = htobe32(bits);
        moved |= memcmp(sent + 4 * i, &bits, sizeof bits) != 0;
        memcpy(sent + 4 * i, &bits, sizeof bits);
    }
    if (moved) renew(m, utime);
}

/* ---- packets ---- */

/* Converts a time to fixed point: seconds since the epoch in the upper 32 bits, and the fraction of a second in the lower 32 bits. */
static igtl_uint64 stamp_of(int64_t utime) {
    igtl_uint64 seconds = (igtl_uint64)(utime / 1000000), us = (igtl_uint64)(utime % 1000000);
    return seconds << 32 | (us << 32) / 1000000;
}

/* Writes what version 2 of the protocol adds around the content: an extended header, with lengths and an unused message ID, and empty metadata. */
static void write_extension(unsigned char *body, size_t content) {
    const uint16_t sizes[2] = {htobe16(EXTENDED_HEADER), htobe16(NO_METADATA)};
    memset(body, 0, EXTENDED_HEADER);
    memcpy(body, sizes, sizeof sizes);
    memset(body + EXTENDED_HEADER + content, 0, NO_METADATA);
}

static igtl_packet *make_packet(const igtl_message *m, int version) {
    size_t content = m->content.length, before = version > 1 ? EXTENDED_HEADER : 0, body = content + before + (version > 1 ? NO_METADATA : 0);
    igtl_packet *packet = malloc(sizeof *packet + IGTL_HEADER_SIZE + body);
    if (!packet) return NULL;
    *packet = (igtl_packet){.users = 1, .size = IGTL_HEADER_SIZE + body};
    unsigned char *place = packet->bytes + IGTL_HEADER_SIZE;
    memcpy(place + before, m->content.data, content);
    if (version > 1) write_extension(place, content);
    igtl_header head = {.version = (igtl_uint16)version, .timestamp = stamp_of(m->utime), .body_size = body,
                        .crc = crc64(place, body, crc64(NULL, 0, 0))};
    memcpy(head.name, m->type, strlen(m->type));
    memcpy(head.device_name, m->name, strlen(m->name));
    igtl_header_convert_byte_order(&head);
    memcpy(packet->bytes, &head, sizeof head);
    return packet;
}

igtl_packet *igtl_take(igtl_message *m, int version) {
    igtl_packet **packet = &m->packets[version > 1];
    if (m->number == 0 || m->content.failed) return NULL;
    if (!*packet) *packet = make_packet(m, version);
    if (*packet) (*packet)->users++;
    return *packet;
}

void igtl_drop(igtl_packet *packet) {
    if (packet && --packet->users == 0) free(packet);
}

/* ---- received ---- */

/* Tests whether a text field is printable ASCII up to its first zero byte. */
static bool is_text(const char *field) {
    for (; *field; field++)
        if (*field < ' ' || *field > '~') return false;
    return true;
}

const char *igtl_read_head(const unsigned char *bytes, igtl_head *head) {
    igtl_header h;
    memcpy(&h, bytes, sizeof h);
    igtl_header_convert_byte_order(&h);
    *head = (igtl_head){.version = h.version, .size = h.body_size, .crc = h.crc};
    memcpy(head->type, h.name, sizeof h.name);
    memcpy(head->name, h.device_name, sizeof h.device_name);
    if (h.version < 1 || h.version > 2 || !head->type[0] || !is_text(head->type) || !is_text(head->name)) return "sent no OpenIGTLink header";
    return h.body_size > LARGEST_BODY ? "announced a message of more than 256 MB" : NULL;
}

const char *igtl_read_transform(const igtl_head *head, unsigned char *body, ras_matrix *matrix) {
    if (crc64(body, head->size, crc64(NULL, 0, 0)) != head->crc) return "has a wrong checksum";
    uint64_t before = 0, after = 0;
    if (head->version > 1) {
        uint16_t sizes[2];
        uint32_t metadata;
        if (head->size < EXTENDED_HEADER) return "is too short";
        memcpy(sizes, body, sizeof sizes);
        memcpy(&metadata, body + sizeof sizes, sizeof metadata);
        before = be16toh(sizes[0]);
        after = (uint64_t)be16toh(sizes[1]) + be32toh(metadata);
    }
    if (head->size != before + IGTL_TRANSFORM_SIZE + after) return "has a wrong size";
    memcpy(matrix->numbers, body + before, IGTL_TRANSFORM_SIZE);
    igtl_transform_convert_byte_order(matrix->numbers);
    return NULL;
}
