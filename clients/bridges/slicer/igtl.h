/* OpenIGTLink messages in encoded form, written and read with the C functions of Debian's library (1.11). That library supports only version 1 of the header;
   the additions of version 2 are implemented here: github.com/openigtlink/OpenIGTLink, Documents/Protocol/header.md. */
#ifndef TROCAR_IGTL_H
#define TROCAR_IGTL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <igtl_header.h>

#include "ras.h"
#include "view/stream/wire_format.h"

/* An encoded message, shared by all clients that receive it. */
typedef struct {
    int users;
    size_t size;
    unsigned char bytes[];
} igtl_packet;

/* The newest value of a named message. A message that has no value yet is not sent. */
typedef struct {
    const char *type;
    char name[IGTL_HEADER_NAME_SIZE + 1];
    int64_t number;          /* number of the newest value, counted from 1; 0 before the first */
    int64_t utime;           /* us since the epoch */
    byte_buffer content;     /* content of the newest value, in network byte order */
    igtl_packet *packets[2]; /* the newest value, encoded with headers of version 1 and 2 on request */
} igtl_message;

void igtl_name(igtl_message *m, const char *type, const char *name); /* truncates the name to 20 bytes if it is longer */
void igtl_free(igtl_message *m);

/* Each of these functions sets the new value of a message. */
void igtl_set_transform(igtl_message *m, int64_t utime, const ras_matrix *matrix);
void igtl_set_string(igtl_message *m, int64_t utime, const char *text);

/* Sets an image of 8-bit grey levels, row by row. `matrix` contains the directions of i, j and k, each as long as a voxel (mm), and the centre of the
   image. An image equal to the previous one does not count as a new value. */
void igtl_set_image(igtl_message *m, int64_t utime, const ras_matrix *matrix, int width, int height, const unsigned char *grey);

/* Make a triangulated surface (each triangle is a 3 followed by the indices of its points), or a curve through points; return false if memory is exhausted. The
   message has no value until igtl_move_points sets its points (x y z, mm). Setting the same points again does not count as a new value. */
bool igtl_make_surface(igtl_message *m, int points, int triangles, uint32_t *polygons);
bool igtl_make_curve(igtl_message *m, int points);
void igtl_move_points(igtl_message *m, int64_t utime, const float *points, int count);

/* Returns the value encoded with a header of version `version` (1 or 2) and adds a reference to it; returns NULL if there is no value or memory is
   exhausted. */
igtl_packet *igtl_take(igtl_message *m, int version);
void igtl_drop(igtl_packet *packet); /* removes one reference and frees the packet if it was the last; NULL is allowed */

/* ---- received ---- */

typedef struct {
    int version;             /* 1 or 2 */
    char type[IGTL_HEADER_TYPE_SIZE + 1], name[IGTL_HEADER_NAME_SIZE + 1];
    uint64_t size, crc;      /* length and checksum of the message's body */
} igtl_head;

/* Reads the header from these IGTL_HEADER_SIZE bytes. Returns NULL, or the reason why they are not a valid header. */
const char *igtl_read_head(const unsigned char *bytes, igtl_head *head);

/* Reads a transform. Returns NULL, or the reason why this body is not a valid TRANSFORM. */
const char *igtl_read_transform(const igtl_head *head, unsigned char *body, ras_matrix *matrix);

#endif
