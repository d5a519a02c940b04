/* Reads a scene document, a tree of sections, lists and keys, as defined by the table. */
#ifndef TROCAR_SCENE_DOCUMENT_H
#define TROCAR_SCENE_DOCUMENT_H

#include "scene/scene_value.h"

/* Reads all keys of a document into the scene. `f` receives the first error. */
void take_document(scene *s, const yaml_value *root, fault *f);

#endif
