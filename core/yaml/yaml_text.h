/* A YAML document as a tree of scalars, lists and mappings, which knows each key's line for use in messages. Uses libyaml. */
#ifndef TROCAR_YAML_TEXT_H
#define TROCAR_YAML_TEXT_H

#include <stdbool.h>
#include <stddef.h>
#include <yaml.h>

#include "base/error.h"

typedef struct { yaml_document_t document; } yaml_text;

typedef enum { YAML_TEXT, YAML_LIST, YAML_MAPPING } yaml_kind;

/* One node. Valid as long as its document is open. */
typedef struct {
    yaml_kind kind;
    const char *text;        /* YAML_TEXT */
    int count;               /* items of a list, or pairs of a mapping */
    yaml_document_t *document;
    yaml_node_t *node;
} yaml_value;

/* Parses a document. BAD_INPUT, with `name` and the line, if the text is empty or not YAML. Call yaml_close only on success. */
trocar_status yaml_open(const char *name, const char *text, size_t length, yaml_text *y, trocar_error *why);
void yaml_close(yaml_text *y);

yaml_value yaml_root(yaml_text *y);
yaml_value yaml_item(const yaml_value *list, int index);

/* Returns the key of a pair ("" if the key is not a scalar) and sets *value to its value. */
const char *yaml_pair(const yaml_value *mapping, int index, yaml_value *value);
bool yaml_has_key(const yaml_value *mapping, const char *key);
bool yaml_key_repeated(const yaml_value *mapping, int index); /* whether an earlier pair has the same key */

/* Returns the line (from 1) of the key or item at a path such as "regions[0].friction.static". If there is none, returns the line of its closest existing
   ancestor. For a repeated key, returns the line of the first. */
int yaml_line(yaml_text *y, const char *path);

#endif
