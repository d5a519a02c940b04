/* The table of scene keys, with one row for each key. It is shared by the code that reads, sets and prints keys and by the reference documentation. */
#ifndef TROCAR_SCENE_TABLE_H
#define TROCAR_SCENE_TABLE_H

#include "scene/scene_struct.h"

enum { KEY_ROOM = 256, WORDS_ROOM = 512 }; /* maximum number of bytes in a key, and in a message about a key */

typedef enum { NUMBER, COUNT, WORD, LENGTH_UNIT, PROFILE, NAME, NAMES, FILE_PATH, DIRECTORY_PATH, POINT, ROTATION, TRANSFORM } value_kind;
typedef enum { NO_LIST, REGIONS, MEMBRANES, CALCIFICATIONS, GUIDES, RELAXATION, LISTS } list_kind;
typedef struct { double low, high; const char *words; } range;
typedef const char *(*word_of)(int index); /* returns NULL if there are no more words */

typedef struct {
    const char *key, *unit;
    value_kind kind;
    size_t offset;           /* offset of the value in `scene` or, for a key in a list, in the list's entry */
    const range *allowed;    /* permitted range, for keys of type NUMBER or COUNT */
    word_of words;           /* permitted words, for keys of type WORD or PROFILE */
    list_kind list;
    bool required;
    bool live;               /* the value may change during a run */
    const char *doc;
} key_spec;

extern const key_spec SCENE_TABLE[];
extern const int SCENE_ROWS;
extern const range ANY_NUMBER;
extern const char UNIT_WORDS[]; /* words that a key of type LENGTH_UNIT accepts */

/* Returns the row of a key pattern such as "regions[].name", or NULL. */
const key_spec *find_key(const char *pattern);

/* True if the key of a row continues `pattern` with `next`, which is "." for a section and "[]" for a list. */
bool leads_on(const char *pattern, const char *next);

/* Writes the words as "a, b or c". */
void list_words(word_of word, char *list, size_t size);

#define PROFILE_SUFFIX ".yaml" /* distinguishes the path of a profile from a name */

/* Writes what a key of type WORD or PROFILE accepts. */
void describe_words(const key_spec *r, char *text, size_t size);

/* Returns the size in metres of a unit given by name; 0 if there is no such unit. */
double unit_size(const char *name);

/* A list of mappings, and its maximum number of entries. */
typedef struct {
    const char *key;
    size_t entries, count, stride; /* offsets in `scene` of the entries and of their count; bytes per entry */
    int least, most;
    bool named;              /* the first member of an entry is its name */
} list_spec;
extern const list_spec LIST_TABLE[LISTS];

void *entry_of(scene *s, list_kind list, int index);
int *count_of(scene *s, list_kind list);
const char *name_of(const scene *s, list_kind list, int index); /* returns NULL if the entries of the list have no names */

/* Appends an entry with default values. There must be room for it. */
void *append_entry(scene *s, list_kind list);

/* For keys of type NAMES: returns the count, and the smallest and largest permitted count. */
int *names_count(scene *s, const key_spec *r, int *least, int *most);

#endif
