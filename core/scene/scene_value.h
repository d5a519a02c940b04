/* Reads the values of scene keys from YAML, and prints them. */
#ifndef TROCAR_SCENE_VALUE_H
#define TROCAR_SCENE_VALUE_H

#include "scene/scene_table.h"
#include "yaml/yaml_text.h"

/* The first error found. Later ones are ignored. */
typedef struct {
    bool found;
    char place[KEY_ROOM];    /* key whose line is reported */
    char key[KEY_ROOM];      /* the key to name in the message; may be empty */
    char words[WORDS_ROOM];
} fault;

__attribute__((format(printf, 4, 5)))
void reject_at(fault *f, const char *place, const char *key, const char *format, ...);
#define reject(f, key, ...) reject_at(f, key, key, __VA_ARGS__)

/* Stores the value of one key in `base`, which is the scene or a list entry. */
void take_value(scene *s, const key_spec *r, const char *key, void *base, const yaml_value *value, fault *f);

/* Prints a value as YAML. Like snprintf, returns the length of the whole text. */
int print_value(const scene *s, const key_spec *r, const void *base, char *value, size_t size);

#endif
