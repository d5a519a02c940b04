#include "json.h"

void json_string(const char *text, FILE *out) {
    fputc('"', out);
    for (const unsigned char *c = (const unsigned char *)text; *c; c++) {
        if (*c < ' ' || *c == '"' || *c == '\\') fprintf(out, "\\u%04x", *c);
        else fputc(*c, out);
    }
    fputc('"', out);
}

void json_time(const histogram *time, FILE *out) {
    fprintf(out, "\"p50_s\": %.9g, \"p99_s\": %.9g, \"max_s\": %.9g", histogram_quantile(time, 0.5),
            histogram_quantile(time, 0.99), histogram_max(time));
}
