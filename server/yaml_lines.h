/* Where the keys of a YAML text stand, for messages. */
#ifndef TROCAR_YAML_LINES_H
#define TROCAR_YAML_LINES_H

#include <stddef.h>
#include <yaml.h>

#include "report.h"

typedef struct { yaml_document_t document; } yaml_lines;

/* BAD_INPUT, with `name` and line, when the text is empty or not YAML. Only after success is yaml_lines_close due. */
trocar_status yaml_lines_open(const char *name, const char *text, size_t length, yaml_lines *lines, report *why);
void yaml_lines_close(yaml_lines *lines);

/* Line (from 1) of the key or entry at a path such as "regions[0].friction.static", or of its innermost parent that is
   there. A repeated key counts where it is first. */
int yaml_lines_find(yaml_lines *lines, const char *path);

#endif
