/* A YAML document as a tree of scalars, lists and mappings, with the line of each key for messages. Uses libyaml. */
#ifndef TROCAR_YAML_TEXT_H
#define TROCAR_YAML_TEXT_H

#include <stdbool.h>
#include <stddef.h>
#include <yaml.h>

#include "base/error.h"

typedef struct { yaml_document_t document; } yaml_text;

typedef enum { YAML_TEXT, YAML_LIST, YAML_MAPPING } yaml_kind;

/* One node; valid as long as its document. */
typedef struct {
    yaml_kind kind;
    const char *text;        /* YAML_TEXT */
    int count;               /* number of items in a list, or of pairs in a mapping */
    yaml_document_t *document;
    yaml_node_t *node;
} yaml_value;

/* Parses a document. BAD_INPUT, with `name` and line, if the text is empty or is not YAML. yaml_close must be called only after success. */
trocar_status yaml_open(const char *name, const char *text, size_t length, yaml_text *y, trocar_error *why);
void yaml_close(yaml_text *y);

yaml_value yaml_root(yaml_text *y);
yaml_value yaml_item(const yaml_value *list, int index);

/* Returns the key of a pair, and its value in *value; a key that is not a scalar is returned as "". */
const char *yaml_pair(const yaml_value *mapping, int index, yaml_value *value);
bool yaml_has_key(const yaml_value *mapping, const char *key);
bool yaml_key_repeated(const yaml_value *mapping, int index); /* true if an earlier pair has the same key */

/* Line (from 1) of the key or item at a path such as "regions[0].friction.static"; if it does not exist, that of its innermost existing parent. For a
   repeated key, the line of its first occurrence. */
int yaml_line(yaml_text *y, const char *path);

#endif
