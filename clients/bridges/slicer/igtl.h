/* Encodes and decodes OpenIGTLink messages with the C functions of Debian's library (1.11). That library knows only version 1 of the header; what version 2
   adds (github.com/openigtlink/OpenIGTLink, Documents/Protocol/header.md) is implemented here. */
#ifndef TROCAR_IGTL_H
#define TROCAR_IGTL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <igtl_header.h>

#include "ras.h"
#include "view/stream/wire_format.h"

/* An encoded message, reference-counted because all clients that receive it share it. */
typedef struct {
    int users;
    size_t size;
    unsigned char bytes[];
} igtl_packet;

/* A named message and its newest value. It is not sent until it has a value. */
typedef struct {
    const char *type;
    char name[IGTL_HEADER_NAME_SIZE + 1];
    int64_t number;          /* number of the newest value, counted from 1; 0 before the first */
    int64_t utime;           /* us since the epoch */
    byte_buffer content;     /* content of the newest value, in network byte order */
    igtl_packet *packets[2]; /* the newest value encoded with a version 1 and a version 2 header, each made when first needed */
} igtl_message;

void igtl_name(igtl_message *m, const char *type, const char *name); /* truncates the name to 20 bytes */
void igtl_free(igtl_message *m);

/* These functions give a message a new value. */
void igtl_set_transform(igtl_message *m, int64_t utime, const ras_matrix *matrix);
void igtl_set_string(igtl_message *m, int64_t utime, const char *text);

/* Sets an image of 8-bit grey levels, stored row by row. matrix: the directions of i, j and k, each as long as a voxel (mm), and the centre of the image. An
   image equal to the previous one does not count as a new value. */
void igtl_set_image(igtl_message *m, int64_t utime, const ras_matrix *matrix, int width, int height, const unsigned char *grey);

/* Set up a message as a triangulated surface (each triangle is a 3 followed by its point indices) or as a curve through points; return false if out of memory.
   The message has no value until igtl_move_points sets its points (x y z, mm). Setting the same points again does not count as a new value. */
bool igtl_make_surface(igtl_message *m, int points, int triangles, uint32_t *polygons);
bool igtl_make_curve(igtl_message *m, int points);
void igtl_move_points(igtl_message *m, int64_t utime, const float *points, int count);

/* Returns a new reference to the value encoded with a header of this version (1 or 2), or NULL if there is no value or no memory. */
igtl_packet *igtl_take(igtl_message *m, int version);
void igtl_drop(igtl_packet *packet); /* drops a reference, and frees the packet if it was the last; NULL is allowed */

/* ---- received ---- */

typedef struct {
    int version;             /* 1 or 2 */
    char type[IGTL_HEADER_TYPE_SIZE + 1], name[IGTL_HEADER_NAME_SIZE + 1];
    uint64_t size, crc;      /* length and checksum of the body */
} igtl_head;

/* Parses the IGTL_HEADER_SIZE bytes of a header. Returns NULL, or a message that says why they are not valid. */
const char *igtl_read_head(const unsigned char *bytes, igtl_head *head);

/* Parses the body of a TRANSFORM. Returns NULL, or a message that says why it is not valid. */
const char *igtl_read_transform(const igtl_head *head, unsigned char *body, ras_matrix *matrix);

#endif
