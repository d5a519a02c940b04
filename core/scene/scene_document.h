/* A scene's document: sections, lists and keys, by the table. */
#ifndef TROCAR_SCENE_DOCUMENT_H
#define TROCAR_SCENE_DOCUMENT_H

#include "scene/scene_value.h"

/* Reads all keys of a document into the scene; the first fault stays in `f`. */
void take_document(scene *s, const yaml_value *root, fault *f);

#endif
