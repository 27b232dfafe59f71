// One frame of `untangle`: where the cloth stands towards the body, and the half-spaces that keep it outside.
#pragma once
#include <memory>
#include <string>
#include <vector>

#include "geometry/box_tree.h"
#include "geometry/membrane.h"
#include "geometry/obstacle.h"
#include "geometry/topology.h"
#include "kernels/untangle.h"

namespace toile {

/// What a cloth keeps from frame to frame.
struct Cloth {
    Cloth(Faces faces, Eigen::Index n);
    void fit_tree(const Vertices& V);     ///< built where it is not yet
    const std::vector<int>& to_border();  ///< edges to the nearest border; the largest int where there is none

    Faces F;
    Adjacency ring;  ///< neighbours of vertices
    std::unique_ptr<BoxTree> tree;
    std::vector<int> tour;  ///< vertices, neighbours in space one after the other

private:
    std::vector<int> to_border_;  ///< empty until asked for
};

class UntangleFrame {
public:
    UntangleFrame(const Vertices& cloth_V, Cloth& cloth, const Obstacle& body, const UntangleOptions& options);

    // Looking. `probe` trusts normals alone; `find_pairs` is exact, and `decide_sides` needs its pairs.
    void probe_all(const std::vector<int>& guesses);  ///< faces of the body near the vertices, or none
    void probe_near();                                ///< where a vertex may have come near since its last probe
    void find_pairs();
    void decide_sides();

    // Acting: half-spaces for the next step.
    bool carry_over();
    void lift_pierced(double least);
    void renew_planes();

    int violations() const;
    int vertices_inside() const;
    Vector depth() const;
    std::string reason_left() const;  ///< why something is left, in words
    std::vector<int> faces_below() const;

    Vertices x;
    Vector margin;                   ///< half the room at most [m]
    std::vector<HalfSpaces> planes;  ///< of the coming step
    Edges pairs;

private:
    Probe& at(Eigen::Index i) { return probes_[static_cast<std::size_t>(i)]; }
    const Probe& at(Eigen::Index i) const { return probes_[static_cast<std::size_t>(i)]; }
    bool violated(Eigen::Index i) const {
        return at(i).constrained && at(i).distance < (1 - options_.relative_tolerance) * margin[i];
    }
    double sure_distance(Eigen::Index i) const;
    bool known_clear(Eigen::Index i) const;
    void shrink_margin(Eigen::Index i);
    bool cut(int i, int j, Eigen::Index first_pair, Eigen::Index last_pair) const;
    Vec3 middle_of_section(Eigen::Index first_pair, Eigen::Index last_pair) const;
    Probe probe_decided(const Vec3& p) const;
    Eigen::Index last_of_face(Eigen::Index pair) const;

    const Vertices& start_;
    Cloth& cloth_;
    const Faces& F_;
    const Obstacle& body_;
    const UntangleOptions& options_;

    double rounding_ = 0;  // of a distance, with room for needles and for places far from the origin [m]
    std::vector<Probe> probes_;
    Vertices probed_at_;
    std::vector<char> given_up_;  // the body gave no direction where the vertex was when its side was decided
    std::vector<char> turned_;    // faces of the body that were found to look inwards
    std::vector<char> was_violated_;
    std::vector<char> carried_;  // to another side of the body in the coming step
    std::vector<int> carries_;   // in how many steps
    std::vector<int> shortfalls_;
    std::vector<HalfSpaces> creases_;  // the other side of a crease
    std::vector<HalfSpaces> lifts_;    // of corners of pierced faces; stay for the frame
    Vertices pushes_;                  // the sum of what lifted a vertex
};

}  // namespace toile
