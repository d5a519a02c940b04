/* OpenIGTLink messages as bytes, written and read with the C functions of Debian's library (1.11). That library knows version 1 of the header;
   version 2's additions are implemented here: github.com/openigtlink/OpenIGTLink, Documents/Protocol/header.md. */
#ifndef TROCAR_IGTL_H
#define TROCAR_IGTL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <igtl_header.h>

#include "ras.h"
#include "view/stream/wire_format.h"

/* An encoded message, shared by the clients that receive it. */
typedef struct {
    int users;
    size_t size;
    unsigned char bytes[];
} igtl_packet;

/* The newest value of the message with one name. A message without a value is not sent. */
typedef struct {
    const char *type;
    char name[IGTL_HEADER_NAME_SIZE + 1];
    int64_t number;          /* number of the newest value, from 1; 0 before the first */
    int64_t utime;           /* us since the epoch */
    byte_buffer content;     /* in the network's byte order */
    igtl_packet *packets[2]; /* the newest value with headers of version 1 and 2, encoded on request */
} igtl_message;

void igtl_name(igtl_message *m, const char *type, const char *name); /* truncates the name to 20 bytes */
void igtl_free(igtl_message *m);

/* Each function gives a message a new value. */
void igtl_set_transform(igtl_message *m, int64_t utime, const ras_matrix *matrix);
void igtl_set_string(igtl_message *m, int64_t utime, const char *text);

/* Image of 8-bit grey levels, row by row. `matrix` contains the directions of i, j and k, each as long as a voxel (mm), and the middle of the
   image. An unchanged image is not a new value. */
void igtl_set_image(igtl_message *m, int64_t utime, const ras_matrix *matrix, int width, int height, const unsigned char *grey);

/* A surface of triangles (each a 3 and the indices of its points), or a curve through points. Create it once, without a value, then move its points
   (x y z, mm). It gets no new value if no point has moved. False if memory is exhausted. */
bool igtl_make_surface(igtl_message *m, int points, int triangles, uint32_t *polygons);
bool igtl_make_curve(igtl_message *m, int points);
void igtl_move_points(igtl_message *m, int64_t utime, const float *points, int count);

/* Returns the value encoded with a header of this version, 1 or 2, for one more user; NULL if there is no value or no memory. */
igtl_packet *igtl_take(igtl_message *m, int version);
void igtl_drop(igtl_packet *packet); /* removes one user; NULL is allowed */

/* ---- received ---- */

typedef struct {
    int version;             /* 1 or 2 */
    char type[IGTL_HEADER_TYPE_SIZE + 1], name[IGTL_HEADER_NAME_SIZE + 1];
    uint64_t size, crc;      /* of the message's body */
} igtl_head;

/* Reads the header in these IGTL_HEADER_SIZE bytes. Returns NULL, or the reason why they are not a header. */
const char *igtl_read_head(const unsigned char *bytes, igtl_head *head);

/* Reads a transform. Returns NULL, or the reason why this body is not a TRANSFORM. */
const char *igtl_read_transform(const igtl_head *head, unsigned char *body, ras_matrix *matrix);

#endif
