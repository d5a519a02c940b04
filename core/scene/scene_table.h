/* The table of scene keys, one row per key. Reading, setting and printing keys all use this table, and so does the reference documentation. */
#ifndef TROCAR_SCENE_TABLE_H
#define TROCAR_SCENE_TABLE_H

#include "scene/scene_struct.h"

enum { KEY_ROOM = 256, WORDS_ROOM = 512 }; /* bytes in a key, and in a message about one */

typedef enum { NUMBER, COUNT, WORD, LENGTH_UNIT, PROFILE, NAME, NAMES, FILE_PATH, DIRECTORY_PATH, POINT, ROTATION, TRANSFORM } value_kind;
typedef enum { NO_LIST, REGIONS, MEMBRANES, SLIDING, CALCIFICATIONS, GUIDES, RELAXATION, LISTS } list_kind;
typedef struct { double low, high; const char *words; } range;
typedef const char *(*word_of)(int index); /* returns NULL past the last word */

typedef struct {
    const char *key, *unit;
    value_kind kind;
    size_t offset;           /* where the value is: offset in `scene` or, for a key in a list, in the list entry */
    const range *allowed;    /* for keys of type NUMBER or COUNT */
    word_of words;           /* for keys of type WORD or PROFILE */
    list_kind list;
    bool required;
    bool live;               /* may change during a run */
    const char *doc;
} key_spec;

extern const key_spec SCENE_TABLE[];
extern const int SCENE_ROWS;
extern const range ANY_NUMBER;
extern const char UNIT_WORDS[]; /* the words that a key of type LENGTH_UNIT may have */

/* Returns the table row of a generic key such as "regions[].name", or NULL. */
const key_spec *find_key(const char *pattern);

/* Returns whether any key in the table starts with `pattern` followed by `next`: "." for a section, "[]" for a list. */
bool leads_on(const char *pattern, const char *next);

/* Writes the words to `list` in the form "a, b or c". */
void list_words(word_of word, char *list, size_t size);

#define PROFILE_SUFFIX ".yaml" /* tells a profile's path from a profile's name */

/* Writes to `text` what values a key of type WORD or PROFILE may have. */
void describe_words(const key_spec *r, char *text, size_t size);

/* Returns a unit's size in metres, given its name; 0 if there is no such unit. */
double unit_size(const char *name);

/* A list of mappings, with the number of entries it can hold. */
typedef struct {
    const char *key;
    size_t entries, count, stride; /* offsets in `scene` of the entries and of their count; size of an entry in bytes */
    int least, most;
    bool named;              /* each entry starts with its name */
} list_spec;
extern const list_spec LIST_TABLE[LISTS];

void *entry_of(scene *s, list_kind list, int index);
int *count_of(scene *s, list_kind list);
const char *name_of(const scene *s, list_kind list, int index); /* NULL if the list's entries have no names */

/* Appends an entry with default values. The list must not be full. */
void *append_entry(scene *s, list_kind list);

/* For a key of type NAMES: returns where its count is stored, and the smallest and largest count allowed. */
int *names_count(scene *s, const key_spec *r, int *least, int *most);

#endif
