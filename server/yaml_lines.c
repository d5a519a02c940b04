#include "yaml_lines.h"

#include <stdlib.h>
#include <string.h>

/* libyaml gives bytes that are no text an offset in place of a line. */
static size_t line_of_problem(const yaml_parser_t *parser, const char *text) {
    if (parser->error != YAML_READER_ERROR) return parser->problem_mark.line + 1;
    size_t line = 1;
    for (size_t i = 0; i < parser->problem_offset; i++) line += text[i] == '\n';
    return line;
}

trocar_status yaml_lines_open(const char *name, const char *text, size_t length, yaml_lines *lines, report *why) {
    yaml_parser_t parser;
    if (!yaml_parser_initialize(&parser)) return fail(why, TROCAR_NO_MEMORY, "%s: no memory to parse it", name);
    yaml_parser_set_input_string(&parser, (const unsigned char *)text, length);
    trocar_status status = TROCAR_OK;
    if (!yaml_parser_load(&parser, &lines->document)) {
        status = fail(why, TROCAR_BAD_INPUT, "%s:%zu: not valid YAML: %s", name, line_of_problem(&parser, text),
                      parser.problem ? parser.problem : "unknown problem");
    } else if (!yaml_document_get_root_node(&lines->document)) {
        yaml_document_delete(&lines->document);
        status = fail(why, TROCAR_BAD_INPUT, "%s: empty", name);
    }
    yaml_parser_delete(&parser);
    return status;
}

void yaml_lines_close(yaml_lines *lines) { yaml_document_delete(&lines->document); }

/* The pair of this key (of this length) in a mapping, or NULL. */
static yaml_node_pair_t *find_pair(yaml_document_t *document, const yaml_node_t *node, const char *key, size_t length) {
    if (node->type != YAML_MAPPING_NODE) return NULL;
    for (yaml_node_pair_t *pair = node->data.mapping.pairs.start; pair < node->data.mapping.pairs.top; pair++) {
        const yaml_node_t *name = yaml_document_get_node(document, pair->key);
        if (name->type == YAML_SCALAR_NODE && name->data.scalar.length == length
            && memcmp(name->data.scalar.value, key, length) == 0)
            return pair;
    }
    return NULL;
}

static yaml_node_t *find_entry(yaml_document_t *document, const yaml_node_t *node, long index) {
    if (node->type != YAML_SEQUENCE_NODE) return NULL;
    long count = node->data.sequence.items.top - node->data.sequence.items.start;
    return index >= 0 && index < count ? yaml_document_get_node(document, node->data.sequence.items.start[index]) : NULL;
}

int yaml_lines_find(yaml_lines *lines, const char *path) {
    yaml_document_t *document = &lines->document;
    yaml_node_t *node = yaml_document_get_root_node(document);
    const yaml_node_t *place = node; /* key or entry that led to `node` */
    while (node && *path) {
        if (*path == '[') {
            char *end;
            node = find_entry(document, node, strtol(path + 1, &end, 10));
            if (node) place = node;
            path = *end == ']' ? end + 1 : end;
        } else {
            if (*path == '.') path++;
            size_t length = strcspn(path, ".[");
            const yaml_node_pair_t *pair = find_pair(document, node, path, length);
            if (pair) place = yaml_document_get_node(document, pair->key);
            node = pair ? yaml_document_get_node(document, pair->value) : NULL;
            path += length;
        }
    }
    return (int)place->start_mark.line + 1;
}
