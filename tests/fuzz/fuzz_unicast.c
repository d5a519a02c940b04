/* Sends several datagrams in a row to the server's gate for unicast clients and to the free client. Three bytes before each give its sender, what is done to
   it, and its length. Random bytes never have the right tag, so the fuzzer may ask for one, and for the token in the gate's last answer. For any input, only
   messages with the right tag and a new counter may be relayed, no answer to a stranger may be larger than what it sent, and the client must render no more
   than its limits. */
#include "fuzz.h"

#define TROCAR_CLIENT_UNICAST
#include "trocar_client.c"
#include "unicast/gate.h"

enum { SENDERS = 4, SEALED = 4, FOR_DIRECTION = 8, WITH_TOKEN = 16, TO_THE_CLIENT = 32, LATER = 64 };

/* Counters of the messages relayed from each sender in its present connection. */
typedef struct {
    unsigned char token[WIRE_TOKEN];
    uint64_t newest, last[64];
    int count;
} relayed_so_far;

static gate *own_gate;
static relayed_so_far relayed[SENDERS];
static int64_t time_now;
static unsigned char last_token[WIRE_TOKEN];

static gate_client *client_of(const struct sockaddr_in *from) {
    for (int i = 0; i < GATE_CLIENTS; i++)
        if (own_gate->clients[i].connected && own_gate->clients[i].address.sin_port == from->sin_port) return &own_gate->clients[i];
    return NULL;
}

static void check_relayed(const gate_client *k, relayed_so_far *r, const unsigned char *datagram, size_t size, const gate_result *result) {
    uint64_t counter = get_number(datagram + 4, 8);
    REQUIRE(k != NULL && wire_is_authentic(&k->to_server, datagram, size));
    if (memcmp(r->token, k->token, WIRE_TOKEN) != 0) memset(r, 0, sizeof *r), memcpy(r->token, k->token, WIRE_TOKEN);
    for (int i = 0; i < r->count; i++) REQUIRE(r->last[i] != counter);
    r->last[r->count < 64 ? r->count++ : (int)(counter % 64)] = counter;
    REQUIRE(strcmp(result->channel, "TROCAR_POSE") == 0 || strcmp(result->channel, "TROCAR_PROBE") == 0 || strcmp(result->channel, "TROCAR_CHANGE") == 0 || strcmp(result->channel, "REMOTE_COMMAND") == 0 ||
            (strcmp(result->channel, "TROCAR_COMMAND") == 0 && (result->size < 28 || get_number(result->bytes + 24, 4) != TROCAR_COMMAND_SHUTDOWN)));
    REQUIRE(result->bytes > datagram && result->bytes + result->size + WIRE_TAG == datagram + size && result->size <= WIRE_MESSAGE_MOST);
}

static void to_gate(unsigned char *datagram, size_t size, int what) {
    static unsigned char fresh[WIRE_TOKEN];
    const struct sockaddr_in from = {.sin_family = AF_INET, .sin_port = htons((uint16_t)(1 + what % SENDERS))};
    gate_client *k = client_of(&from);
    gate_result result;
    if ((what & SEALED) && size >= WIRE_TAG) {
        bool direction = (what & FOR_DIRECTION) && k != NULL;
        wire_tag(direction ? &k->to_server : &own_gate->secret, datagram, size - WIRE_TAG, datagram + size - WIRE_TAG);
    }
    for (size_t i = 0; i < sizeof time_now; i++) fresh[i] = (unsigned char)(time_now >> 8 * i);
    int kind = wire_kind_of(datagram, size);
    gate_verdict verdict = gate_take(own_gate, datagram, size, &from, time_now, fresh, &result);
    if (verdict == GATE_RELAY) check_relayed(client_of(&from), &relayed[what % SENDERS], datagram, size, &result);
    if (verdict == GATE_ANSWER) {
        REQUIRE(result.answer_size > 0 && result.answer_size <= size);
        if (kind != WIRE_TO_SERVER) memcpy(last_token, result.answer + 20, WIRE_TOKEN);
    }
    REQUIRE(gate_present(own_gate, time_now) <= SENDERS);
    for (int i = 0; i < GATE_CLIENTS; i++) {
        unsigned char to[WIRE_MOST];
        REQUIRE(gate_put(own_gate, i, 1, "TROCAR_WRENCH", to, 0, time_now, to) <= WIRE_MOST);
    }
}

static void to_client(trocar_client *c, unsigned char *datagram, size_t size, int what) {
    trocar_client_wrench w;
    if ((what & SEALED) && size >= TAG) {
        const unsigned char *key = (what & FOR_DIRECTION) && c->link.connected ? c->link.to_client : c->link.secret;
        hmac(key, KEY, datagram, size - TAG, datagram + size - TAG);
    }
    bool connected = c->link.connected;
    double heard = c->link.heard_at;
    bool good = size >= TAG && is_authentic(connected ? c->link.to_client : c->link.secret, datagram, size);
    take_unicast(c, datagram, size);
    REQUIRE(good || (c->link.connected == connected && c->link.heard_at == heard));
    trocar_client_newest(c, &w);
    REQUIRE(length_of(w.force) <= MAX_FORCE * (1 + 1e-12) && length_of(w.torque) <= MAX_TORQUE * (1 + 1e-12)); /* fails for NaN, too */
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const wire_key secret = {{1}}, cookie = {{2}};
    static trocar_client *c, *fresh_client;
    if (c == NULL) {
        own_gate = malloc(sizeof *own_gate);
        c = create_client(&(trocar_client_options){0});
        fresh_client = create_client(&(trocar_client_options){0});
        REQUIRE(own_gate != NULL && c != NULL && fresh_client != NULL);
        fresh_client->session = 1;
        fresh_client->link.used = true;
        memcpy(fresh_client->link.secret, secret.bytes, KEY);
    }
    memcpy(c, fresh_client, offsetof(trocar_client, assembly.bytes)); /* copies everything except two buffers */
    gate_init(own_gate, &secret, &cookie);
    memset(relayed, 0, sizeof relayed);
    memset(last_token, 0, sizeof last_token);
    time_now = 1;
    while (size >= 3) {
        int what = data[0];
        size_t length = (size_t)data[1] << 8 | data[2];
        data += 3, size -= 3;
        if (length > size) length = size;
        unsigned char *datagram = malloc(length + 1); /* a separate allocation, so that reading past its end is detected */
        REQUIRE(datagram != NULL);
        memcpy(datagram + 1, data, length);
        if ((what & WITH_TOKEN) && length >= WIRE_HANDSHAKE) memcpy(datagram + 1 + 20, last_token, WIRE_TOKEN);
        time_now += what & LATER ? 700000000 : 1000000;
        if (what & TO_THE_CLIENT) to_client(c, datagram + 1, length, what);
        else to_gate(datagram + 1, length, what);
        free(datagram);
        data += length, size -= length;
    }
    return 0;
}
