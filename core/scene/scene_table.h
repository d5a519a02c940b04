/* The table of scene keys: one row each, shared by reading, setting, printing and the reference documentation. */
#ifndef TROCAR_SCENE_TABLE_H
#define TROCAR_SCENE_TABLE_H

#include "scene/scene_struct.h"

enum { KEY_ROOM = 256, WORDS_ROOM = 512 }; /* bytes of a key, and of a message about a key */

typedef enum { NUMBER, COUNT, WORD, LENGTH_UNIT, PROFILE, NAME, NAMES, FILE_PATH, DIRECTORY_PATH, POINT, ROTATION, TRANSFORM } value_kind;
typedef enum { NO_LIST, REGIONS, MEMBRANES, GUIDES, RELAXATION, LISTS } list_kind;
typedef struct { double low, high; const char *words; } range;
typedef const char *(*word_of)(int index); /* returns NULL past the last one */

typedef struct {
    const char *key, *unit;
    value_kind kind;
    size_t offset;           /* offset of the value in `scene`, or in the list entry */
    const range *allowed;    /* NUMBER, COUNT */
    word_of words;           /* WORD, PROFILE */
    list_kind list;
    bool required;
    const char *doc;
} key_spec;

extern const key_spec SCENE_TABLE[];
extern const int SCENE_ROWS;
extern const range ANY_NUMBER;
extern const char UNIT_WORDS[]; /* accepted values of LENGTH_UNIT */

/* The row of a key pattern such as "regions[].name", or NULL. */
const key_spec *find_key(const char *pattern);

/* True if a row's key continues `pattern` with `next`: "." for a section, "[]" for a list. */
bool leads_on(const char *pattern, const char *next);

/* "a, b or c" */
void list_words(word_of word, char *list, size_t size);

/* Size in metres of a named unit; 0 if there is no such unit. */
double unit_size(const char *name);

/* A list of mappings, and the largest number of entries. */
typedef struct {
    const char *key;
    size_t entries, count, stride; /* offsets in `scene`; bytes per entry */
    int least, most;
} list_spec;
extern const list_spec LIST_TABLE[LISTS];

void *entry_of(scene *s, list_kind list, int index);
int *count_of(scene *s, list_kind list);
const char *name_of(const scene *s, list_kind list, int index); /* returns NULL if the list's entries have no names */

/* Appends an entry with default values. There must be room for it. */
void *append_entry(scene *s, list_kind list);

/* NAMES: offset of the count, and the largest count. */
int *names_count(scene *s, const key_spec *r, int *least, int *most);

#endif
