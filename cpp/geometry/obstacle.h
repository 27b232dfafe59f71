// A surface that other things must stay outside of: where a point stands towards it and which way is out.
#pragma once
#include <memory>
#include <vector>

#include "base/types.h"
#include "geometry/box_tree.h"
#include "geometry/topology.h"
#include "geometry/winding.h"

namespace toile {

struct Probe {
    double distance = 0;          ///< [m], negative inside
    double nearest = 0;           ///< [m], to the closest point of the surface, whatever the side
    Vec3 point = Vec3::Zero();    ///< the closest point of the surface [m]
    Vec3 outward = Vec3::Zero();  ///< unit; from the surface outwards through the probe, or the surface's normal on it
    int face = -1;                ///< of the closest point
    bool sided = false;           ///< false: the closest face has no area, hence no side
    bool behind = false;          ///< the probe is where the closest face's normal does not point
    bool constrained =
        false;  ///< false: the surface gives no direction here (beyond a border, in an overlap, too deep)
    bool inside() const { return distance < 0; }
    void turn() { outward = -outward, distance = -distance; }  ///< to the other side
};

/// Keeps the topology and the tree of a surface that moves from frame to frame; call `move` first.
///
/// Probes tell sides by the normal at the closest point. That is right but where a closed surface overlaps itself or has a
/// pocket that is turned inside out: there `decide` corrects a probe by the winding number (either orientation of the
/// faces). An open surface has no inside well beyond a border, or deeper than `max_depth`.
class Obstacle {
public:
    Obstacle(Faces F, double max_depth);

    void move(const Vertices& V);
    void follow(const Vertices& V);  ///< probes alone: winding numbers and orientation stay those of the last move
    bool closed() const { return closed_; }  ///< no edge with one face only
    /// A closed surface whose volume vanishes within rounding: nothing is inside it, or its parts cancel.
    bool hollow() const { return hollow_; }
    Eigen::Index faces() const { return F_.rows(); }
    const BoxTree& tree() const { return *tree_; }
    const BoxTree::Triangle& triangle(int face) const { return tree_->triangle(tree_->slot_of(face)); }

    Probe probe(const Vec3& p, int guess = -1) const;  ///< a face near the closest point saves time and changes nothing
    /// How many parts of a closed surface p is inside of; negative in a pocket turned inside out, which is solid as well.
    int parts(const Vec3& p) const;
    void decide(Probe& probe, int parts) const;  ///< `parts` at the probe; once for a probe
    /// Does the closest face of a probe with so many parts look inwards? -1: it cannot be told.
    static int turned(const Probe& probe, int parts);
    /// For p inside another part than the nearest: straight on along the probe's direction through all parts. Becomes the
    /// probe of the face where that comes out; false if it does not within `max_depth`.
    bool pass_through(const Vec3& p, Probe& probe) const;

private:
    void pair_sides(int begin, int end);
    Vec3 face_normal(int face) const;
    Vec3 vertex_normal(int vertex) const;
    Vec3 pseudo_normal(const SurfacePoint& s) const;
    bool on_border(const SurfacePoint& s) const;

    Faces F_;
    double max_depth_;
    bool closed_ = true;
    Faces across_;              ///< (m,3) the face beyond edge (c, c+1); negative where there is not just one
    std::vector<char> border_;  ///< per vertex, up to the largest index
    Adjacency faces_of_;        ///< of vertices
    double orientation_ = 1;    ///< -1: a closed surface whose faces look inwards
    double size_ = 1;           ///< diagonal of the box [m]
    bool hollow_ = false;
    std::unique_ptr<BoxTree> tree_;
    std::unique_ptr<WindingMoments> winding_;
};

}  // namespace toile
