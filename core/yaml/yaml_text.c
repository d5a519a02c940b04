#include "yaml/yaml_text.h"

#include <stdlib.h>
#include <string.h>

/* Returns the line of a parse error, counting from 1. If the text is not valid UTF-8 or UTF-16, libyaml gives only the offset, so the lines are counted here.
   */
static size_t line_of_problem(const yaml_parser_t *parser, const char *text) {
    if (parser->error != YAML_READER_ERROR) return parser->problem_mark.line + 1;
    size_t line = 1;
    for (size_t i = 0; i < parser->problem_offset; i++) line += text[i] == '\n';
    return line;
}

trocar_status yaml_open(const char *name, const char *text, size_t length, yaml_text *y, trocar_error *why) {
    yaml_parser_t parser;
    if (!yaml_parser_initialize(&parser)) return fail(why, TROCAR_NO_MEMORY, "%s: no memory to parse it", name);
    yaml_parser_set_input_string(&parser, (const unsigned char *)text, length);
    trocar_status status = TROCAR_OK;
    if (!yaml_parser_load(&parser, &y->document)) {
        status = fail(why, TROCAR_BAD_INPUT, "%s:%zu: not valid YAML: %s", name, line_of_problem(&parser, text),
                      parser.problem ? parser.problem : "unknown problem");
    } else if (!yaml_document_get_root_node(&y->document)) {
        yaml_document_delete(&y->document);
        status = fail(why, TROCAR_BAD_INPUT, "%s: empty", name);
    }
    yaml_parser_delete(&parser);
    return status;
}

void yaml_close(yaml_text *y) { yaml_document_delete(&y->document); }

static yaml_value value_of(yaml_document_t *document, yaml_node_t *node) {
    yaml_value v = {.kind = YAML_TEXT, .text = "", .document = document, .node = node};
    if (node->type == YAML_SEQUENCE_NODE) {
        v.kind = YAML_LIST;
        v.count = (int)(node->data.sequence.items.top - node->data.sequence.items.start);
    } else if (node->type == YAML_MAPPING_NODE) {
        v.kind = YAML_MAPPING;
        v.count = (int)(node->data.mapping.pairs.top - node->data.mapping.pairs.start);
    } else if (node->type == YAML_SCALAR_NODE) {
        v.text = (const char *)node->data.scalar.value;
    }
    return v;
}

yaml_value yaml_root(yaml_text *y) { return value_of(&y->document, yaml_document_get_root_node(&y->document)); }

yaml_value yaml_item(const yaml_value *list, int index) {
    return value_of(list->document, yaml_document_get_node(list->document, list->node->data.sequence.items.start[index]));
}

static const char *key_of(const yaml_value *mapping, int index) {
    const yaml_node_t *key = yaml_document_get_node(mapping->document, mapping->node->data.mapping.pairs.start[index].key);
    return key->type == YAML_SCALAR_NODE ? (const char *)key->data.scalar.value : "";
}

const char *yaml_pair(const yaml_value *mapping, int index, yaml_value *value) {
    *value = value_of(mapping->document, yaml_document_get_node(mapping->document, mapping->node->data.mapping.pairs.start[index].value));
    return key_of(mapping, index);
}

bool yaml_has_key(const yaml_value *mapping, const char *key) {
    for (int i = 0; mapping->kind == YAML_MAPPING && i < mapping->count; i++)
        if (strcmp(key_of(mapping, i), key) == 0) return true;
    return false;
}

bool yaml_key_repeated(const yaml_value *mapping, int index) {
    for (int i = 0; i < index; i++)
        if (strcmp(key_of(mapping, i), key_of(mapping, index)) == 0) return true;
    return false;
}

/* Returns the value of a key, which has `length` characters, or NULL if there is none. Points *place at the key's node. */
static yaml_node_t *find_pair(yaml_document_t *document, const yaml_node_t *node, const char *key, size_t length, const yaml_node_t **place) {
    if (node->type != YAML_MAPPING_NODE) return NULL;
    for (yaml_node_pair_t *pair = node->data.mapping.pairs.start; pair < node->data.mapping.pairs.top; pair++) {
        const yaml_node_t *name = yaml_document_get_node(document, pair->key);
        if (name->type != YAML_SCALAR_NODE || name->data.scalar.length != length || memcmp(name->data.scalar.value, key, length) != 0) continue;
        *place = name;
        return yaml_document_get_node(document, pair->value);
    }
    return NULL;
}

static yaml_node_t *find_item(yaml_document_t *document, const yaml_node_t *node, long index, const yaml_node_t **place) {
    if (node->type != YAML_SEQUENCE_NODE) return NULL;
    long count = node->data.sequence.items.top - node->data.sequence.items.start;
    if (index < 0 || index >= count) return NULL;
    yaml_node_t *item = yaml_document_get_node(document, node->data.sequence.items.start[index]);
    *place = item;
    return item;
}

int yaml_line(yaml_text *y, const char *path) {
    yaml_document_t *document = &y->document;
    yaml_node_t *node = yaml_document_get_root_node(document);
    const yaml_node_t *place = node; /* the key or list item that led to `node` */
    while (node && *path) {
        if (*path == '[') {
            char *end;
            node = find_item(document, node, strtol(path + 1, &end, 10), &place);
            path = *end == ']' ? end + 1 : end;
        } else {
            if (*path == '.') path++;
            size_t length = strcspn(path, ".[");
            node = find_pair(document, node, path, length, &place);
            path += length;
        }
    }
    return (int)place->start_mark.line + 1;
}
