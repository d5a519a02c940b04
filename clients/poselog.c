#include "poselog.h"

#include <errno.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "guard.h"

/* LCM's own reader trusts the lengths that it finds, prints to stderr and resumes at the next magic number: a damaged
   log would pass for a shorter one. The format is simple enough to read with checks. An event on disk, big-endian:
   magic, event number (8), timestamp (8), two lengths (4 each), channel, data. */
enum { EVENT_HEADER = 28, EVENT_CHANNEL_LENGTH = 20, EVENT_DATA_LENGTH = 24, CHANNEL_MAX = 63, POSE_MAX = 256 };
static const unsigned char event_magic[4] = {0xED, 0xA1, 0xDA, 0x01};

/* A log being read. */
typedef struct {
    const char *path;
    FILE *file;
    int64_t size, offset;    /* bytes */
    int64_t event;           /* number of the current event */
} reader;

typedef struct {
    int64_t channel_length, data_length;
    char channel[CHANNEL_MAX + 1];
} event_header;

static int64_t big_endian_32(const unsigned char *bytes) {
    return (int64_t)bytes[0] << 24 | (int64_t)bytes[1] << 16 | (int64_t)bytes[2] << 8 | bytes[3];
}

static trocar_status reader_open(const char *path, reader *r, report *why) {
    *r = (reader){.path = path};
    struct stat status;
    if (stat(path, &status) != 0) return fail(why, TROCAR_BAD_INPUT, "%s: %s", path, strerror(errno));
    if (!S_ISREG(status.st_mode)) return fail(why, TROCAR_BAD_INPUT, "%s: not a regular file", path);
    r->size = status.st_size;
    r->file = fopen(path, "r");
    return r->file ? TROCAR_OK : fail(why, TROCAR_BAD_INPUT, "%s: cannot be opened: %s", path, strerror(errno));
}

static trocar_status bad_event(const reader *r, const char *fault, report *why) {
    return fail(why, TROCAR_BAD_INPUT, "%s: event %" PRId64 " at byte %" PRId64 ": %s", r->path, r->event, r->offset, fault);
}

static trocar_status read_header(reader *r, event_header *h, report *why) {
    unsigned char bytes[EVENT_HEADER] = {0};
    size_t got = fread(bytes, 1, sizeof bytes, r->file), compared = got < sizeof event_magic ? got : sizeof event_magic;
    if (memcmp(bytes, event_magic, compared) != 0)
        return bad_event(r, r->event ? "no LCM event here: the log is damaged" : "not an LCM log", why);
    h->channel_length = big_endian_32(bytes + EVENT_CHANNEL_LENGTH);
    h->data_length = big_endian_32(bytes + EVENT_DATA_LENGTH);
    if (got < sizeof bytes || EVENT_HEADER + h->channel_length + h->data_length > r->size - r->offset)
        return bad_event(r, "the log is cut short", why);
    if (h->channel_length < 1 || h->channel_length > CHANNEL_MAX)
        return bad_event(r, "impossible length of the channel name: the log is damaged", why);
    size_t length = (size_t)h->channel_length;
    h->channel[length] = '\0';
    return fread(h->channel, 1, length, r->file) == length ? TROCAR_OK : bad_event(r, "cannot be read", why);
}

/* Leaves the file at the next event. */
static trocar_status skip_event(reader *r, const event_header *h, report *why) {
    r->offset += EVENT_HEADER + h->channel_length + h->data_length;
    r->event++;
    return fseeko(r->file, r->offset, SEEK_SET) == 0 ? TROCAR_OK : bad_event(r, strerror(errno), why);
}

static pose raw_pose(const trocar_needle_pose_t *message) {
    const double *x = message->position, *q = message->orientation;
    return (pose){v3(x[0], x[1], x[2]), {q[0], q[1], q[2], q[3]}};
}

static trocar_status read_pose(const reader *r, const event_header *h, trocar_needle_pose_t *p, report *why) {
    unsigned char data[POSE_MAX];
    int length = h->data_length <= POSE_MAX ? (int)h->data_length : 0;
    if (fread(data, 1, (size_t)length, r->file) != (size_t)length) return bad_event(r, "cannot be read", why);
    if (length == 0 || trocar_needle_pose_t_decode(data, 0, length, p) != length)
        return bad_event(r, "not a trocar.needle_pose_t", why);
    pose base = raw_pose(p);
    pose_verdict verdict = guard_check_pose(&base);
    if (verdict == POSE_NOT_FINITE) return bad_event(r, "pose is not finite", why);
    return verdict == POSE_ACCEPTED ? TROCAR_OK : bad_event(r, "orientation is not a unit quaternion", why);
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
                    r->path, r->event, p->utime, last->utime);
    trocar_status status = make_room(log, why);
    if (status != TROCAR_OK) return status;
    log->poses[log->count] = *p;
    log->events[log->count++] = r->event;
    return TROCAR_OK;
}

static trocar_status read_event(reader *r, pose_log *log, report *why) {
    event_header h;
    trocar_status status = read_header(r, &h, why);
    if (status == TROCAR_OK && strcmp(h.channel, POSE_CHANNEL) == 0) {
        trocar_needle_pose_t p;
        status = read_pose(r, &h, &p, why);
        if (status == TROCAR_OK) status = append_pose(r, &p, log, why);
    }
    return status == TROCAR_OK ? skip_event(r, &h, why) : status;
}

trocar_status pose_log_read(const char *path, pose_log *log, report *why) {
    *log = (pose_log){0};
    reader r;
    trocar_status status = reader_open(path, &r, why);
    if (status != TROCAR_OK) return status;
    while (status == TROCAR_OK && r.offset < r.size) status = read_event(&r, log, why);
    fclose(r.file);
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
