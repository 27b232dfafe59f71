// What the faces of a mesh say by themselves, without positions.
#pragma once
#include <utility>
#include <vector>

#include "../base/types.h"

namespace toile {

/// Undirected edges (i < j), sorted, each once.
Edges unique_edges(const Faces& F);

/// Vertex neighbours in compressed rows: those of v are `index[start[v]] .. index[start[v + 1]]`, ascending.
struct Adjacency {
    std::vector<int> start, index;
    int size() const { return static_cast<int>(start.size()) - 1; }
};
Adjacency vertex_neighbours(const Faces& F, Eigen::Index n);
Adjacency vertex_faces(const Faces& F, Eigen::Index n);

/// Boundary loops as vertex cycles in the direction of their faces' half-edges, longest (in vertices) first; equal
/// lengths by smallest vertex. Each cycle starts at its smallest vertex and passes none twice: where loops touch, each is one
/// by itself. Neighbours that run opposite ways cut no loop. Sides on no cycle, as beside edges of three faces, are left out.
std::vector<std::vector<int>> boundary_loops(const Faces& F);

/// (m,3): the face beyond the edge opposite each corner, -1 where that edge has not exactly two faces.
Faces face_neighbours(const Faces& F);

/// Per vertex: does it lie on an edge that has one face only?
std::vector<char> border_vertices(const Faces& F, Eigen::Index n);

/// Connected component per vertex, numbered by first vertex; isolated vertices are components of their own.
Indices vertex_components(const Faces& F, Eigen::Index n);

}  // namespace toile
