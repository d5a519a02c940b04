#include "common/host_port.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

bool split_host_port(const char *text, const char *standard_port, char host[256], char port[6]) {
    bool brackets = text[0] == '[';
    const char *begin = text + brackets, *end = begin + strcspn(begin, brackets ? "]" : ":");
    if (end == begin || end - begin > 255 || (brackets && *end != ']')) return false;
    snprintf(host, 256, "%.*s", (int)(end - begin), begin);
    const char *colon = end + brackets;
    if (*colon == '\0' && standard_port) snprintf(port, 6, "%s", standard_port);
    if (*colon == '\0') return standard_port != NULL;
    if (*colon != ':' || colon[1] < '0' || colon[1] > '9') return false;
    char *rest;
    long number = strtol(colon + 1, &rest, 10);
    if (*rest || number < 1 || number > 65535) return false;
    snprintf(port, 6, "%ld", number);
    return true;
}
