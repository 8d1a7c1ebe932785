#pragma once
// The tables of directional albedos that a scene's materials need (Material::albedo_table and its like).

#include "scene/model/scene.h"

namespace gleaner::scene {

// Fills in Scene::albedo_tables and the materials' places in it; f0 must stand. Equal materials share a table.
void make_albedo_tables(Scene& scene);

}  // namespace gleaner::scene
