#include "shared/poselog.h"

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "base/input_file.h"
#include "common/message_fit.h"
#include "common/messages.h"
#include "intake/probe_arbiter.h"
#include "intake/safety_limits.h"
#include "trocar_command_reply_t.h"

/* LCM's own reader trusts the lengths in the file, prints to stderr, and after an error resumes at the next magic number, so that a damaged log merely looks
   shorter. This reader checks everything instead. An event in the file is big-endian: magic (4), event number (8), timestamp (8), length of the channel name
   (4), length of the data (4), channel name, data. */
enum { EVENT_HEADER = 28, EVENT_CHANNEL_LENGTH = 20, EVENT_DATA_LENGTH = 24, CHANNEL_MAX = 63, DATA_MAX = 512, CHANGE_MAX = 4096, STATUS_MAX = 4096 };
static const unsigned char event_magic[4] = {0xED, 0xA1, 0xDA, 0x01};

/* An older release's version of a message type, which lacks the last fields: `needle` in poses; `needle`, or `server` and `needle`, in wrenches; `state`, or
   the last five fields, in a status. */
typedef struct {
    uint64_t fingerprint;
    int missing;             /* bytes */
} older_type;

static const older_type older_poses[] = {{0xbe3af96bc721e5ea, 4}, {0}};
static const older_type older_wrenches[] = {{0x558602e319c11faf, 4}, {0x9bb829ef4984e48c, 8 + 4}, {0}};
static const older_type older_statuses[] = {{0xe428bcd4a42ff814, 4}, {0xbcbe6819f8e2446a, 3 * 4 + 8 + 4}, {0}};

/* State of the pose readers: the log, the last accepted poses, and the server's own code for accepting poses of the probe. */
typedef struct {
    pose_log *poses;
    bool keeps;              /* true if poses are stored in `poses`, false if they are only counted */
    trocar_needle_pose_t newest[TROCAR_MAX_NEEDLES]; /* last accepted pose of each needle */
    bool begun[TROCAR_MAX_NEEDLES]; /* true once a pose of the needle has been accepted */
    probe_arbiter probe;
    trocar_probe_pose_t *passed; /* probe poses since the last needle pose; unused if all poses are kept */
    int passed_count, passed_room;
    trocar_needle_pose_t pose; /* the last accepted pose */
    bool accepted;           /* true if the last event was accepted */
} reading;

/* A log being read. */
typedef struct {
    const char *path;
    FILE *file;
    int64_t size, offset;    /* bytes */
    int64_t event;           /* of the current event */
    bool cut;                /* true if the file ends within the current event */
    bool found;              /* true if the log has an event on the first wanted channel */
} reader;

typedef struct {
    int64_t channel_length, data_length;
    char channel[CHANNEL_MAX + 1];
} event_header;

static int64_t big_endian_32(const unsigned char *bytes) {
    return (int64_t)bytes[0] << 24 | (int64_t)bytes[1] << 16 | (int64_t)bytes[2] << 8 | bytes[3];
}

static int64_t big_endian_64(const unsigned char *bytes) {
    return (int64_t)((uint64_t)big_endian_32(bytes) << 32 | (uint64_t)big_endian_32(bytes + 4));
}

static trocar_status reader_open(const char *path, reader *r, trocar_error *why) {
    *r = (reader){.path = path};
    struct stat status;
    const char *reason;
    r->file = input_open(path, &reason);
    if (!r->file) return fail(why, TROCAR_BAD_INPUT, "%s: %s", path, reason);
    if (fstat(fileno(r->file), &status) == 0) {
        r->size = status.st_size;
        return TROCAR_OK;
    }
    fclose(r->file);
    return fail(why, TROCAR_BAD_INPUT, "%s: %s", path, strerror(errno));
}

static trocar_status bad_event(const reader *r, const char *fault, trocar_error *why) {
    return fail(why, TROCAR_BAD_INPUT, "%s: event %" PRId64 " at byte %" PRId64 ": %s", r->path, r->event, r->offset, fault);
}

static trocar_status read_header(reader *r, event_header *h, trocar_error *why) {
    unsigned char bytes[EVENT_HEADER] = {0};
    size_t got = fread(bytes, 1, sizeof bytes, r->file), compared = got < sizeof event_magic ? got : sizeof event_magic;
    if (memcmp(bytes, event_magic, compared) != 0)
        return bad_event(r, r->event ? "no LCM event here: the log is damaged" : "not an LCM log", why);
    h->channel_length = big_endian_32(bytes + EVENT_CHANNEL_LENGTH);
    h->data_length = big_endian_32(bytes + EVENT_DATA_LENGTH);
    r->cut = got < sizeof bytes || EVENT_HEADER + h->channel_length + h->data_length > r->size - r->offset;
    if (r->cut) return bad_event(r, "the log is truncated", why);
    if (h->channel_length < 1 || h->channel_length > CHANNEL_MAX)
        return bad_event(r, "impossible length of the channel name: the log is damaged", why);
    size_t length = (size_t)h->channel_length;
    h->channel[length] = '\0';
    return fread(h->channel, 1, length, r->file) == length ? TROCAR_OK : bad_event(r, "cannot be read", why);
}

/* Moves on to the next event. */
static trocar_status skip_event(reader *r, const event_header *h, trocar_error *why) {
    r->offset += EVENT_HEADER + h->channel_length + h->data_length;
    r->event++;
    return fseeko(r->file, r->offset, SEEK_SET) == 0 ? TROCAR_OK : bad_event(r, strerror(errno), why);
}

static trocar_status read_data(const reader *r, const event_header *h, unsigned char *data, int64_t room, trocar_error *why) {
    size_t length = (size_t)(h->data_length < room ? h->data_length : room);
    return fread(data, 1, length, r->file) == length ? TROCAR_OK : bad_event(r, "cannot be read", why);
}

/* Checks that the data start with the fingerprint of their type. */
static trocar_status check_type(const reader *r, const unsigned char *data, const char *type, int64_t fingerprint, trocar_error *why) {
    int64_t found = big_endian_64(data);
    if (found == fingerprint) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT,
                "%s: event %" PRId64 " at byte %" PRId64 ": not a trocar.%s of this version (fingerprint %016" PRIx64
                ", here %016" PRIx64 "): recorded with another lcmtypes/trocar.lcm? Then replay it with that release",
                r->path, r->event, r->offset, type, (uint64_t)found, (uint64_t)fingerprint);
}

/* Converts a message of an older type to the current one: replaces the fingerprint and appends the missing fields as zeros. Returns the new length. `data` must
   have room for it and contain zeros after the message. */
static int64_t complete(unsigned char *data, int64_t length, const older_type *older, int64_t fingerprint) {
    uint64_t found = (uint64_t)big_endian_64(data);
    while (older->missing && older->fingerprint != found) older++;
    if (!older->missing) return length;
    for (int i = 0; i < 8; i++) data[i] = (unsigned char)((uint64_t)fingerprint >> (56 - 8 * i));
    return length + older->missing;
}

static trocar_status read_pose(const reader *r, const event_header *h, trocar_needle_pose_t *p, trocar_error *why) {
    unsigned char data[DATA_MAX] = {0};
    trocar_status status = read_data(r, h, data, DATA_MAX, why);
    int64_t length = complete(data, h->data_length, older_poses, __trocar_needle_pose_t_get_hash());
    if (status == TROCAR_OK) status = check_type(r, data, "needle_pose_t", __trocar_needle_pose_t_get_hash(), why);
    if (status != TROCAR_OK) return status;
    if (length != trocar_needle_pose_t_decode(data, 0, DATA_MAX, p))
        return bad_event(r, "not the length of a trocar.needle_pose_t: the log is damaged", why);
    if (p->needle < 0 || p->needle >= TROCAR_MAX_NEEDLES) return bad_event(r, "pose of a needle that no scene has: the log is damaged", why);
    pose base = load_pose(p->position, p->orientation);
    pose_verdict verdict = safety_check_pose(&base);
    if (verdict == POSE_NOT_FINITE) return bad_event(r, "pose is not finite", why);
    return verdict == POSE_ACCEPTED ? TROCAR_OK : bad_event(r, "orientation is not a unit quaternion", why);
}

static trocar_status read_wrench(const reader *r, const event_header *h, trocar_needle_wrench_t *w, trocar_error *why) {
    unsigned char data[DATA_MAX] = {0};
    trocar_status status = read_data(r, h, data, DATA_MAX, why);
    int64_t length = complete(data, h->data_length, older_wrenches, __trocar_needle_wrench_t_get_hash());
    if (status == TROCAR_OK) status = check_type(r, data, "needle_wrench_t", __trocar_needle_wrench_t_get_hash(), why);
    if (status != TROCAR_OK) return status;
    if (length == trocar_needle_wrench_t_decode(data, 0, DATA_MAX, w)) return TROCAR_OK;
    return bad_event(r, "not the length of a trocar.needle_wrench_t: the log is damaged", why);
}

static bool is_finite(const trocar_needle_wrench_t *w) {
    for (int i = 0; i < 3; i++)
        if (!isfinite(w->raw_force[i]) || !isfinite(w->raw_torque[i])) return false;
    return true;
}

/* Makes room for one more element in an array of `count`. The capacity doubles whenever the count reaches a power of two. */
static trocar_status make_room(void **array, int count, size_t size, trocar_error *why) {
    if (count & (count - 1)) return TROCAR_OK;
    size_t room = count ? 2 * (size_t)count : 1;
    void *moved = realloc(*array, room * size);
    if (!moved) return fail(why, TROCAR_NO_MEMORY, "no memory for %zu messages", room);
    *array = moved;
    return TROCAR_OK;
}

static trocar_status add_pose(const trocar_needle_pose_t *p, reading *in, trocar_error *why) {
    pose_log *log = in->poses;
    if (in->keeps) {
        void *poses = log->poses;
        trocar_status status = make_room(&poses, log->count, sizeof *log->poses, why);
        log->poses = poses;
        if (status != TROCAR_OK) return status;
        log->poses[log->count] = *p;
    }
    if (log->count++ == 0) log->first = *p;
    log->last = in->pose = in->newest[p->needle] = *p;
    in->begun[p->needle] = in->accepted = true;
    if (p->needle > log->most_needle) log->most_needle = p->needle;
    return TROCAR_OK;
}

/* Accepts poses as the server does: only those of one needle and session, and none that is repeated or out of order. */
static trocar_status append_pose(const reader *r, const trocar_needle_pose_t *p, reading *in, trocar_error *why) {
    pose_log *log = in->poses;
    const trocar_needle_pose_t *last = log->count ? &log->last : NULL;
    if (log->needle < 0) log->needle = p->needle;
    if (p->needle != log->needle || (last && p->session != last->session)) {
        log->skipped_sessions++;
        return TROCAR_OK;
    }
    if (last && p->seq <= last->seq) {
        log->skipped_old++;
        return TROCAR_OK;
    }
    if (last && p->utime <= last->utime)
        return fail(why, TROCAR_BAD_INPUT, "%s: event %" PRId64 ": time does not advance: utime %" PRId64 " after %" PRId64,
                    r->path, r->event, p->utime, last->utime);
    return add_pose(p, in, why);
}

static trocar_status take_pose(const reader *r, const event_header *h, void *context, trocar_error *why) {
    reading *in = context;
    trocar_needle_pose_t p = {0};
    trocar_status status = read_pose(r, h, &p, why);
    return status == TROCAR_OK ? append_pose(r, &p, in, why) : status;
}

/* State of the wrench readers. */
typedef struct {
    trocar_needle_wrench_t wrench; /* the last accepted wrench */
    bool accepted;           /* true if the last event was accepted */
    int64_t skipped;         /* wrenches skipped because they are not finite */
    char inverse[16];
} wrench_reading;

static trocar_status take_wrench(const reader *r, const event_header *h, void *context, trocar_error *why) {
    wrench_reading *in = context;
    trocar_needle_wrench_t w;
    trocar_status status = read_wrench(r, h, &w, why);
    if (status != TROCAR_OK || w.pose_seq < 0) return status;
    in->accepted = is_finite(&w);
    if (in->accepted) in->wrench = w;
    else in->skipped++;
    return TROCAR_OK;
}

static trocar_status add_command(const trocar_command_t *m, pose_log *log, trocar_error *why) {
    void *commands = log->commands;
    trocar_status status = make_room(&commands, log->command_count, sizeof *log->commands, why);
    log->commands = commands;
    if (status == TROCAR_OK) log->commands[log->command_count++] = (logged_command){.next_pose = log->count, .command = *m};
    if (m->needle > log->most_needle) log->most_needle = m->needle;
    return status;
}

static trocar_status decode_command(const reader *r, const event_header *h, const unsigned char data[DATA_MAX], trocar_command_t *m, trocar_error *why) {
    if (h->data_length == trocar_command_t_decode(data, 0, DATA_MAX, m)) return TROCAR_OK;
    return bad_event(r, "not the length of a trocar.command_t: the log is damaged", why);
}

/* Records a seed command. Ignores commands of older message types, which have no seeds. */
static trocar_status note_command(const reader *r, const event_header *h, void *context, trocar_error *why) {
    pose_log *log = ((reading *)context)->poses;
    unsigned char data[DATA_MAX] = {0};
    trocar_command_t m;
    trocar_status status = read_data(r, h, data, DATA_MAX, why);
    if (status != TROCAR_OK || big_endian_64(data) != __trocar_command_t_get_hash()) return status;
    status = decode_command(r, h, data, &m, why);
    if (status != TROCAR_OK) return status;
    if (m.command != TROCAR_COMMAND_T_DROP_SEED && m.command != TROCAR_COMMAND_T_UNDO && m.command != TROCAR_COMMAND_T_CLEAR) return TROCAR_OK;
    if (log->count == 0 || m.needle != log->needle || m.session != log->first.session) {
        log->skipped_commands++;
        return TROCAR_OK;
    }
    return add_command(&m, log, why);
}

/* Records a change. Its sender does not matter, because a change affects all needles. */
static trocar_status note_change(const reader *r, const event_header *h, void *context, trocar_error *why) {
    pose_log *log = ((reading *)context)->poses;
    unsigned char data[CHANGE_MAX] = {0};
    trocar_change_t m;
    trocar_status status = read_data(r, h, data, CHANGE_MAX, why);
    if (status == TROCAR_OK) status = check_type(r, data, "change_t", __trocar_change_t_get_hash(), why);
    if (status != TROCAR_OK) return status;
    if (h->data_length > CHANGE_MAX || !change_fits(data, (size_t)h->data_length) || trocar_change_t_decode(data, 0, CHANGE_MAX, &m) < 0)
        return bad_event(r, "not the length of a trocar.change_t: the log is damaged", why);
    status = add_command(&(trocar_command_t){.utime = m.utime, .session = m.session, .command = TROCAR_COMMAND_T_CHANGE, .seq = m.seq}, log, why);
    if (status == TROCAR_OK) {
        logged_command *added = &log->commands[log->command_count - 1];
        added->change_time = m.time;
        added->change = m.values;
        m.values = NULL; /* now belongs to the log */
    }
    free(m.values);
    return status;
}

enum { MOST_UNANSWERED = 1024 }; /* most commands that may await an answer; a server has fewer pending */

/* Moves a change to the end of the commands. It takes effect only when the server replies, because new moduli may need minutes of preparation. */
static void move_to_end(pose_log *log, logged_command *change) {
    logged_command moved = *change, *last = log->commands + log->command_count - 1;
    memmove(change, change + 1, (size_t)(last - change) * sizeof *change);
    moved.next_pose = log->count;
    *last = moved;
}

/* Records the server's answer to a command. Ignores replies of another message type. */
static trocar_status note_reply(const reader *r, const event_header *h, void *context, trocar_error *why) {
    pose_log *log = ((reading *)context)->poses;
    unsigned char data[DATA_MAX] = {0};
    trocar_command_reply_t m;
    trocar_status status = read_data(r, h, data, DATA_MAX, why);
    if (status != TROCAR_OK || h->data_length > DATA_MAX || !reply_fits(data, (size_t)h->data_length)) return status;
    if (trocar_command_reply_t_decode(data, 0, (int)h->data_length, &m) < 0) return TROCAR_OK;
    logged_command *asked = NULL; /* the oldest unanswered one, because a sender may reuse a number */
    for (int i = log->command_count - 1; i >= 0 && log->command_count - i <= MOST_UNANSWERED; i--) {
        const trocar_command_t *c = &log->commands[i].command;
        bool same = c->session == m.session && c->seq == m.seq && c->needle == m.needle && c->command == m.command;
        if (same && log->commands[i].answer == ANSWER_UNKNOWN) asked = &log->commands[i];
    }
    if (asked && m.status != TROCAR_COMMAND_REPLY_T_PENDING) {
        asked->answer = m.status == TROCAR_COMMAND_REPLY_T_DONE ? ANSWER_DONE : ANSWER_REFUSED;
        if (asked->change) move_to_end(log, asked);
    }
    trocar_command_reply_t_decode_cleanup(&m);
    return TROCAR_OK;
}

/* Notes the type of inverse that a status names. Ignores statuses of another message type. */
static trocar_status take_status(const reader *r, const event_header *h, void *context, trocar_error *why) {
    wrench_reading *in = context;
    unsigned char data[STATUS_MAX] = {0};
    trocar_status_t m;
    trocar_status status = read_data(r, h, data, STATUS_MAX, why);
    int64_t length = complete(data, h->data_length, older_statuses, __trocar_status_t_get_hash());
    if (status != TROCAR_OK || length > STATUS_MAX || !status_fits(data, (size_t)length)) return status;
    if (trocar_status_t_decode(data, 0, (int)length, &m) < 0) return TROCAR_OK;
    snprintf(in->inverse, sizeof in->inverse, "%s", m.inverse);
    trocar_status_t_decode_cleanup(&m);
    return TROCAR_OK;
}

static trocar_status keep_probe(const trocar_probe_pose_t *m, pose_log *log, trocar_error *why) {
    void *probes = log->probes;
    trocar_status status = make_room(&probes, log->probe_count, sizeof *log->probes, why);
    log->probes = probes;
    if (status == TROCAR_OK) log->probes[log->probe_count++] = (logged_probe){.next_pose = log->count, .pose = *m};
    return status;
}

/* Keeps a probe pose until the next needle pose. */
static trocar_status pass_probe(const trocar_probe_pose_t *m, reading *in, trocar_error *why) {
    in->poses->probe_count++;
    if (in->accepted) in->passed_count = 0;
    in->accepted = false;
    if (in->passed_count == in->passed_room) {
        int room = in->passed_room ? 2 * in->passed_room : 64;
        void *moved = realloc(in->passed, (size_t)room * sizeof *in->passed);
        if (!moved) return fail(why, TROCAR_NO_MEMORY, "no memory for %d poses of the probe", room);
        in->passed = moved;
        in->passed_room = room;
    }
    in->passed[in->passed_count++] = *m;
    return TROCAR_OK;
}

/* Accepts or refuses a probe pose by the server's own rules, with the poses' timestamps as the clock. */
static trocar_status note_probe(const reader *r, const event_header *h, void *context, trocar_error *why) {
    reading *in = context;
    pose_log *log = in->poses;
    unsigned char data[DATA_MAX] = {0};
    trocar_probe_pose_t m;
    trocar_error refusal;
    trocar_status status = read_data(r, h, data, DATA_MAX, why);
    if (status == TROCAR_OK) status = check_type(r, data, "probe_pose_t", __trocar_probe_pose_t_get_hash(), why);
    if (status != TROCAR_OK) return status;
    if (h->data_length != trocar_probe_pose_t_decode(data, 0, DATA_MAX, &m))
        return bad_event(r, "not the length of a trocar.probe_pose_t: the log is damaged", why);
    if (m.utime < 0 || m.utime > INT64_MAX / 1000) return bad_event(r, "impossible time of a pose of the probe: the log is damaged", why);
    if (!probe_arbiter_pose(&in->probe, data, (size_t)h->data_length, 1000 * m.utime, refusal.text, sizeof refusal.text)) {
        log->skipped_probes++;
        return TROCAR_OK;
    }
    return in->keeps ? keep_probe(&m, log, why) : pass_probe(&m, in, why);
}

/* A channel to read. `take` handles each event; the file is then positioned at the event's data. */
typedef struct {
    const char *channel;
    trocar_status (*take)(const reader *r, const event_header *h, void *log, trocar_error *why);
} wanted_channel;

/* Reads an event, or skips it if its channel is not wanted. The last entry of `wanted` is empty. If the log is cut off within this event and `cut` is not NULL,
   treats the log as ending before the event, and writes a message about it to `cut`. */
static trocar_status read_event(reader *r, const wanted_channel *wanted, void *context, trocar_error *cut, trocar_error *why) {
    event_header h;
    trocar_status status = read_header(r, &h, why);
    if (r->cut && cut) {
        *cut = *why;
        r->size = r->offset;
        return TROCAR_OK;
    }
    const wanted_channel *match = wanted;
    while (status == TROCAR_OK && match->channel && strcmp(h.channel, match->channel) != 0) match++;
    if (status == TROCAR_OK && match->channel) status = match->take(r, &h, context, why);
    r->found |= match == wanted;
    return status == TROCAR_OK ? skip_event(r, &h, why) : status;
}

/* Fails if the log has no event on the first wanted channel. */
static trocar_status check_found(const reader *r, const wanted_channel *wanted, trocar_error *why) {
    if (r->found) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "%s: nothing on channel %s in %" PRId64 " events", r->path, wanted->channel, r->event);
}

/* Reads all events. */
static trocar_status read_log(const char *path, const wanted_channel *wanted, void *context, trocar_error *cut, trocar_error *why) {
    reader r;
    trocar_status status = reader_open(path, &r, why);
    if (status != TROCAR_OK) return status;
    while (status == TROCAR_OK && r.offset < r.size) status = read_event(&r, wanted, context, cut, why);
    fclose(r.file);
    return status == TROCAR_OK ? check_found(&r, wanted, why) : status;
}

/* Accepts poses of all needles, as long as each is later than the previous pose of its needle and session. */
static trocar_status take_any_pose(const reader *r, const event_header *h, void *context, trocar_error *why) {
    reading *in = context;
    trocar_needle_pose_t p = {0};
    trocar_status status = read_pose(r, h, &p, why);
    if (status != TROCAR_OK) return status;
    const trocar_needle_pose_t *last = in->begun[p.needle] ? &in->newest[p.needle] : NULL;
    if (last && p.session == last->session && (p.seq <= last->seq || p.utime <= last->utime)) {
        in->poses->skipped_old++;
        return TROCAR_OK;
    }
    return add_pose(&p, in, why);
}

static trocar_status take_command(const reader *r, const event_header *h, void *context, trocar_error *why) {
    pose_log *log = ((reading *)context)->poses;
    unsigned char data[DATA_MAX] = {0};
    trocar_command_t m;
    trocar_status status = read_data(r, h, data, DATA_MAX, why);
    if (status == TROCAR_OK) status = check_type(r, data, "command_t", __trocar_command_t_get_hash(), why);
    if (status == TROCAR_OK) status = decode_command(r, h, data, &m, why);
    if (status != TROCAR_OK) return status;
    if (m.needle < 0 || m.needle >= TROCAR_MAX_NEEDLES) return bad_event(r, "command for a needle that no scene has: the log is damaged", why);
    return add_command(&m, log, why);
}

static const wanted_channel ALL[] = {{POSE_CHANNEL, take_any_pose}, {COMMAND_CHANNEL, take_command}, {CHANGE_CHANNEL, note_change}, {REPLY_CHANNEL, note_reply}, {PROBE_CHANNEL, note_probe}, {0}};
static const wanted_channel OF_ONE[] = {{POSE_CHANNEL, take_pose}, {COMMAND_CHANNEL, note_command}, {CHANGE_CHANNEL, note_change}, {REPLY_CHANNEL, note_reply}, {PROBE_CHANNEL, note_probe}, {0}};

static void begin_reading(reading *in, pose_log *log, int needle, bool keeps) {
    *log = (pose_log){.needle = needle, .most_needle = -1};
    memset(in, 0, sizeof *in);
    in->poses = log;
    in->keeps = keeps;
    probe_arbiter_init(&in->probe);
}

/* Reads the poses of this needle, or of the first pose's needle if `needle` is -1. */
static trocar_status read_poses(const char *path, int needle, bool all, bool keeps, pose_log *log, trocar_error *cut, trocar_error *why) {
    reading *in = malloc(sizeof *in);
    if (!in) return fail(why, TROCAR_NO_MEMORY, "%s: no memory to read it", path);
    begin_reading(in, log, needle, keeps);
    trocar_status status = read_log(path, all ? ALL : OF_ONE, in, cut, why);
    free(in->passed);
    free(in);
    if (status == TROCAR_OK && log->count == 0) status = fail(why, TROCAR_BAD_INPUT, "%s: no pose of needle %d", path, needle);
    if (status != TROCAR_OK) pose_log_free(log);
    else if (all) log->needle = log->first.needle;
    return status;
}

trocar_status pose_log_read_all(const char *path, pose_log *log, trocar_error *why) { return read_poses(path, -1, true, true, log, NULL, why); }

trocar_status pose_log_read(const char *path, pose_log *log, trocar_error *why) { return read_poses(path, -1, false, true, log, NULL, why); }

trocar_status pose_log_read_needle(const char *path, int needle, pose_log *log, trocar_error *why) {
    return read_poses(path, needle, false, true, log, NULL, why);
}

trocar_status pose_log_read_to_cut(const char *path, pose_log *log, trocar_error *cut, trocar_error *why) {
    *cut = (trocar_error){0};
    return read_poses(path, -1, false, true, log, cut, why);
}

trocar_status pose_log_scan(const char *path, int needle, bool all, pose_log *log, trocar_error *why) {
    return read_poses(path, needle, all, false, log, NULL, why);
}

/* ---- streams ------------------------------------------------------------------------------------------------------------ */

struct pose_stream {
    reader file;
    const wanted_channel *wanted;
    reading in;
    pose_log log;            /* the log, which is read a second time for counts and commands */
};

trocar_status pose_stream_open(const char *path, int needle, bool all, pose_stream **opened, trocar_error *why) {
    pose_stream *s = calloc(1, sizeof *s);
    *opened = NULL;
    if (!s) return fail(why, TROCAR_NO_MEMORY, "%s: no memory to read it", path);
    s->wanted = all ? ALL : OF_ONE;
    begin_reading(&s->in, &s->log, needle, false);
    trocar_status status = reader_open(path, &s->file, why);
    if (status == TROCAR_OK) *opened = s;
    else pose_stream_close(s);
    return status;
}

trocar_status pose_stream_next(pose_stream *s, pose_step *step, trocar_error *why) {
    trocar_status status = TROCAR_OK;
    s->in.accepted = false;
    s->in.passed_count = 0;
    while (status == TROCAR_OK && !s->in.accepted && s->file.offset < s->file.size) status = read_event(&s->file, s->wanted, &s->in, NULL, why);
    *step = (pose_step){.ended = !s->in.accepted, .pose = s->in.pose, .probe_count = s->in.passed_count, .probes = s->in.passed};
    return status;
}

void pose_stream_close(pose_stream *s) {
    if (!s) return;
    if (s->file.file) fclose(s->file.file);
    free(s->in.passed);
    pose_log_free(&s->log);
    free(s);
}

static const wanted_channel WRENCHES[] = {{WRENCH_CHANNEL, take_wrench}, {STATUS_CHANNEL, take_status}, {0}};

struct wrench_stream {
    reader file;
    wrench_reading in;
};

trocar_status wrench_stream_open(const char *path, wrench_stream **opened, trocar_error *why) {
    wrench_stream *s = calloc(1, sizeof *s);
    *opened = NULL;
    if (!s) return fail(why, TROCAR_NO_MEMORY, "%s: no memory to read it", path);
    trocar_status status = reader_open(path, &s->file, why);
    if (status == TROCAR_OK) *opened = s;
    else wrench_stream_close(s);
    return status;
}

trocar_status wrench_stream_next(wrench_stream *s, trocar_needle_wrench_t *wrench, bool *ended, trocar_error *why) {
    trocar_status status = TROCAR_OK;
    s->in.accepted = false;
    while (status == TROCAR_OK && !s->in.accepted && s->file.offset < s->file.size) status = read_event(&s->file, WRENCHES, &s->in, NULL, why);
    *ended = !s->in.accepted;
    *wrench = s->in.wrench;
    return status == TROCAR_OK && *ended ? check_found(&s->file, WRENCHES, why) : status;
}

int64_t wrench_stream_skipped(const wrench_stream *s) { return s->in.skipped; }
const char *wrench_stream_inverse(const wrench_stream *s) { return s->in.inverse; }

void wrench_stream_close(wrench_stream *s) {
    if (!s) return;
    if (s->file.file) fclose(s->file.file);
    free(s);
}

trocar_status wrench_log_read(const char *path, wrench_log *log, trocar_error *why) {
    wrench_stream *stream;
    bool ended = false;
    *log = (wrench_log){0};
    trocar_status status = wrench_stream_open(path, &stream, why);
    if (status != TROCAR_OK) return status;
    while (status == TROCAR_OK && !ended) {
        trocar_needle_wrench_t wrench;
        status = wrench_stream_next(stream, &wrench, &ended, why);
        if (status != TROCAR_OK || ended) break;
        void *wrenches = log->wrenches;
        status = make_room(&wrenches, log->count, sizeof wrench, why);
        log->wrenches = wrenches;
        if (status == TROCAR_OK) log->wrenches[log->count++] = wrench;
    }
    log->skipped_not_finite = wrench_stream_skipped(stream);
    snprintf(log->inverse, sizeof log->inverse, "%s", wrench_stream_inverse(stream));
    wrench_stream_close(stream);
    if (status != TROCAR_OK) wrench_log_free(log);
    return status;
}

void wrench_log_free(wrench_log *log) {
    free(log->wrenches);
    *log = (wrench_log){0};
}

void pose_log_free(pose_log *log) {
    free(log->poses);
    for (int i = 0; i < log->command_count; i++) free(log->commands[i].change);
    free(log->commands);
    free(log->probes);
    *log = (pose_log){0};
}

double pose_log_time(const pose_log *log, int i) { return 1e-6 * (double)(log->poses[i].utime - log->poses[0].utime); }

double pose_log_interval(const pose_log *log, int i, double rate_hz, int *gaps) {
    if (i == 0) return 1.0 / rate_hz;
    double dt = 1e-6 * (double)(log->poses[i].utime - log->poses[i - 1].utime);
    if (dt <= POSE_LOG_GAP) return dt;
    (*gaps)++;
    return POSE_LOG_GAP;
}

trocar_pose base_of_probe(const trocar_probe_pose_t *message) {
    pose base = load_pose(message->position, message->orientation);
    base.orientation = q_unit(base.orientation);
    return library_pose(base);
}

trocar_status pose_log_move_probe(const pose_log *log, int i, const trocar_model *model, trocar_sim *sim, int *done, trocar_error *why) {
    const trocar_probe_pose_t *newest = NULL;
    for (; *done < log->probe_count && log->probes[*done].next_pose <= i; (*done)++) newest = &log->probes[*done].pose;
    trocar_probe_shape ignored;
    if (!newest || !trocar_model_probe(model, &ignored)) return TROCAR_OK;
    trocar_pose to = base_of_probe(newest);
    return trocar_sim_set_probe(sim, &to, why);
}

pose pose_of_message(const trocar_needle_pose_t *message) {
    pose p = load_pose(message->position, message->orientation);
    p.orientation = q_unit(p.orientation);
    return p;
}

trocar_needle_pose_t message_of_pose(pose p, int64_t utime, int64_t session, int64_t seq) {
    return (trocar_needle_pose_t){
        .utime = utime, .session = session, .seq = seq, .wrench_tick = -1,
        .position = {p.position.x, p.position.y, p.position.z},
        .orientation = {p.orientation.w, p.orientation.x, p.orientation.y, p.orientation.z}};
}

static trocar_status write_event(lcm_eventlog_t *log, int64_t utime, const char *channel, uint8_t *data, int length,
                                 const char *path, trocar_error *why) {
    lcm_eventlog_event_t event = {.timestamp = utime, .channel = (char *)channel, .channellen = (int32_t)strlen(channel),
                                  .data = data, .datalen = length};
    if (length >= 0 && lcm_eventlog_write_event(log, &event) == 0) return TROCAR_OK;
    return fail(why, TROCAR_SYSTEM, "%s: cannot be written: %s", path, strerror(errno));
}

trocar_status log_write_command(lcm_eventlog_t *log, const trocar_command_t *message, const char *path, trocar_error *why) {
    uint8_t data[256];
    int length = trocar_command_t_encode(data, 0, sizeof data, message);
    return write_event(log, message->utime, COMMAND_CHANNEL, data, length, path, why);
}

trocar_status log_write_change(lcm_eventlog_t *log, const logged_command *change, const char *path, trocar_error *why) {
    uint8_t data[CHANGE_MAX];
    const trocar_command_t *c = &change->command;
    trocar_change_t m = {.utime = c->utime, .session = c->session, .seq = c->seq, .time = change->change_time, .values = change->change};
    int length = trocar_change_t_encode(data, 0, sizeof data, &m);
    return write_event(log, m.utime, CHANGE_CHANNEL, data, length, path, why);
}

trocar_status log_write_reply(lcm_eventlog_t *log, const trocar_command_t *command, bool done, const char *path, trocar_error *why) {
    uint8_t data[256];
    trocar_command_reply_t m = {.utime = command->utime, .session = command->session, .seq = command->seq, .command = command->command, .needle = command->needle,
                                .status = done ? TROCAR_COMMAND_REPLY_T_DONE : TROCAR_COMMAND_REPLY_T_REFUSED, .message = (char[]){""}};
    int length = trocar_command_reply_t_encode(data, 0, sizeof data, &m);
    return write_event(log, m.utime, REPLY_CHANNEL, data, length, path, why);
}

trocar_status log_write_probe(lcm_eventlog_t *log, const trocar_probe_pose_t *message, const char *path, trocar_error *why) {
    uint8_t data[256];
    int length = trocar_probe_pose_t_encode(data, 0, sizeof data, message);
    return write_event(log, message->utime, PROBE_CHANNEL, data, length, path, why);
}

trocar_status log_write_pose(lcm_eventlog_t *log, const trocar_needle_pose_t *message, const char *path, trocar_error *why) {
    uint8_t data[256];
    int length = trocar_needle_pose_t_encode(data, 0, sizeof data, message);
    return write_event(log, message->utime, POSE_CHANNEL, data, length, path, why);
}

trocar_status log_write_wrench(lcm_eventlog_t *log, const trocar_needle_wrench_t *message, const char *path, trocar_error *why) {
    uint8_t data[512];
    int length = trocar_needle_wrench_t_encode(data, 0, sizeof data, message);
    return write_event(log, message->pose_utime, WRENCH_CHANNEL, data, length, path, why);
}

trocar_status log_write_status(lcm_eventlog_t *log, const trocar_status_t *message, const char *path, trocar_error *why) {
    uint8_t data[STATUS_MAX];
    int length = trocar_status_t_encode(data, 0, sizeof data, message);
    return write_event(log, message->utime, STATUS_CHANNEL, data, length, path, why);
}
