#include "poselog.h"

#include <errno.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "guard.h"

/* An event on disk, all big-endian: magic, event number (8), timestamp (8), two lengths (4 each), channel, data. */
enum { EVENT_HEADER = 28, EVENT_CHANNEL_LENGTH = 20, EVENT_DATA_LENGTH = 24, CHANNEL_MAX = 63 };
static const unsigned char event_magic[4] = {0xED, 0xA1, 0xDA, 0x01};

/* A log being read. */
typedef struct {
    const char *path;
    lcm_eventlog_t *file;
    int64_t size, offset;    /* bytes */
    int64_t event;           /* events read */
} reader;

static int64_t big_endian_32(const unsigned char *bytes) {
    return (int64_t)bytes[0] << 24 | (int64_t)bytes[1] << 16 | (int64_t)bytes[2] << 8 | bytes[3];
}

static trocar_status reader_open(const char *path, reader *r, report *why) {
    *r = (reader){.path = path};
    struct stat status;
    if (stat(path, &status) != 0) return fail(why, TROCAR_BAD_INPUT, "%s: %s", path, strerror(errno));
    if (!S_ISREG(status.st_mode)) return fail(why, TROCAR_BAD_INPUT, "%s: not a regular file", path);
    r->size = status.st_size;
    r->file = lcm_eventlog_create(path, "r");
    return r->file ? TROCAR_OK : fail(why, TROCAR_BAD_INPUT, "%s: cannot be opened: %s", path, strerror(errno));
}

/* LCM's reader trusts the lengths that it finds and skips to the next magic number where one is missing: look at the
   header before it does. */
static trocar_status check_header(reader *r, report *why) {
    unsigned char header[EVENT_HEADER];
    int64_t left = r->size - r->offset;
    size_t got = fread(header, 1, sizeof header, r->file->f);
    if (got == sizeof header && memcmp(header, event_magic, sizeof event_magic) != 0)
        return fail(why, TROCAR_BAD_INPUT, "%s: byte %" PRId64 ": no LCM event here (event %" PRId64 "): %s", r->path,
                    r->offset, r->event, r->event ? "the log is damaged" : "not an LCM log");
    int64_t channel = big_endian_32(header + EVENT_CHANNEL_LENGTH), data = big_endian_32(header + EVENT_DATA_LENGTH);
    if (got < sizeof header || EVENT_HEADER + channel + data > left)
        return fail(why, TROCAR_BAD_INPUT, "%s: event %" PRId64 " at byte %" PRId64 ": the log is cut short", r->path,
                    r->event, r->offset);
    if (channel < 1 || channel > CHANNEL_MAX)
        return fail(why, TROCAR_BAD_INPUT, "%s: event %" PRId64 " at byte %" PRId64 ": channel name of %" PRId64
                    " bytes: the log is damaged", r->path, r->event, r->offset, channel);
    return fseeko(r->file->f, r->offset, SEEK_SET) == 0 ? TROCAR_OK
         : fail(why, TROCAR_SYSTEM, "%s: %s", r->path, strerror(errno));
}

/* The next event, or NULL at the end. */
static trocar_status reader_next(reader *r, lcm_eventlog_event_t **event, report *why) {
    *event = NULL;
    if (r->offset == r->size) return TROCAR_OK;
    trocar_status status = check_header(r, why);
    if (status != TROCAR_OK) return status;
    *event = lcm_eventlog_read_next_event(r->file);
    if (!*event)
        return fail(why, TROCAR_BAD_INPUT, "%s: event %" PRId64 " at byte %" PRId64 " cannot be read", r->path, r->event,
                    r->offset);
    r->offset += EVENT_HEADER + (*event)->channellen + (*event)->datalen;
    r->event++;
    return TROCAR_OK;
}

static pose raw_pose(const trocar_needle_pose_t *message) {
    const double *x = message->position, *q = message->orientation;
    return (pose){v3(x[0], x[1], x[2]), {q[0], q[1], q[2], q[3]}};
}

static trocar_status decode_pose(const reader *r, const lcm_eventlog_event_t *event, trocar_needle_pose_t *p, report *why) {
    const char *fault = NULL;
    if (trocar_needle_pose_t_decode(event->data, 0, event->datalen, p) != event->datalen) {
        fault = "not a trocar.needle_pose_t";
    } else {
        pose base = raw_pose(p);
        pose_verdict verdict = guard_check_pose(&base);
        if (verdict == POSE_NOT_FINITE) fault = "pose is not finite";
        else if (verdict != POSE_ACCEPTED) fault = "orientation is not a unit quaternion";
    }
    return fault ? fail(why, TROCAR_BAD_INPUT, "%s: event %" PRId64 ": %s", r->path, r->event - 1, fault) : TROCAR_OK;
}

/* Doubles the room when the count reaches a power of two. */
static trocar_status make_room(pose_log *log, report *why) {
    int count = log->count;
    if (count & (count - 1)) return TROCAR_OK;
    size_t room = count ? 2 * (size_t)count : 1;
    trocar_needle_pose_t *poses = realloc(log->poses, room * sizeof *poses);
    if (poses) log->poses = poses;
    int64_t *events = realloc(log->events, room * sizeof *events);
    if (events) log->events = events;
    return poses && events ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for %zu poses", room);
}

static trocar_status append_pose(const reader *r, const trocar_needle_pose_t *p, pose_log *log, report *why) {
    const trocar_needle_pose_t *last = log->count ? &log->poses[log->count - 1] : NULL;
    if (last && p->session != last->session) {
        log->skipped_sessions++;
        return TROCAR_OK;
    }
    if (last && p->utime <= last->utime)
        return fail(why, TROCAR_BAD_INPUT, "%s: event %" PRId64 ": time does not advance: utime %" PRId64 " after %" PRId64,
                    r->path, r->event - 1, p->utime, last->utime);
    trocar_status status = make_room(log, why);
    if (status != TROCAR_OK) return status;
    log->poses[log->count] = *p;
    log->events[log->count++] = r->event - 1;
    return TROCAR_OK;
}

static trocar_status read_all(reader *r, pose_log *log, report *why) {
    for (;;) {
        lcm_eventlog_event_t *event;
        trocar_needle_pose_t p;
        trocar_status status = reader_next(r, &event, why);
        if (status != TROCAR_OK || !event) return status;
        if (strcmp(event->channel, POSE_CHANNEL) == 0) {
            status = decode_pose(r, event, &p, why);
            if (status == TROCAR_OK) status = append_pose(r, &p, log, why);
        }
        lcm_eventlog_free_event(event);
        if (status != TROCAR_OK) return status;
    }
}

trocar_status pose_log_read(const char *path, pose_log *log, report *why) {
    *log = (pose_log){0};
    reader r;
    trocar_status status = reader_open(path, &r, why);
    if (status != TROCAR_OK) return status;
    status = read_all(&r, log, why);
    lcm_eventlog_destroy(r.file);
    if (status == TROCAR_OK && log->count == 0)
        status = fail(why, TROCAR_BAD_INPUT, "%s: no pose on channel %s in %" PRId64 " events", path, POSE_CHANNEL, r.event);
    if (status != TROCAR_OK) pose_log_free(log);
    return status;
}

void pose_log_free(pose_log *log) {
    free(log->poses);
    free(log->events);
    *log = (pose_log){0};
}

pose pose_of_message(const trocar_needle_pose_t *message) {
    pose p = raw_pose(message);
    p.orientation = q_unit(p.orientation);
    return p;
}

trocar_needle_pose_t message_of_pose(pose p, int64_t utime, int64_t session, int64_t seq) {
    return (trocar_needle_pose_t){
        .utime = utime, .session = session, .seq = seq,
        .position = {p.position.x, p.position.y, p.position.z},
        .orientation = {p.orientation.w, p.orientation.x, p.orientation.y, p.orientation.z}};
}

static trocar_status write_event(lcm_eventlog_t *log, int64_t utime, const char *channel, uint8_t *data, int length,
                                 const char *path, report *why) {
    lcm_eventlog_event_t event = {.timestamp = utime, .channel = (char *)channel, .channellen = (int32_t)strlen(channel),
                                  .data = data, .datalen = length};
    if (length >= 0 && lcm_eventlog_write_event(log, &event) == 0) return TROCAR_OK;
    return fail(why, TROCAR_SYSTEM, "%s: cannot be written: %s", path, strerror(errno));
}

trocar_status log_write_pose(lcm_eventlog_t *log, const trocar_needle_pose_t *message, const char *path, report *why) {
    uint8_t data[256];
    int length = trocar_needle_pose_t_encode(data, 0, sizeof data, message);
    return write_event(log, message->utime, POSE_CHANNEL, data, length, path, why);
}

trocar_status log_write_wrench(lcm_eventlog_t *log, const trocar_needle_wrench_t *message, const char *path, report *why) {
    uint8_t data[512];
    int length = trocar_needle_wrench_t_encode(data, 0, sizeof data, message);
    return write_event(log, message->pose_utime, WRENCH_CHANNEL, data, length, path, why);
}
