// A tree of axis-parallel boxes over the triangles of a mesh, in double, so that no pair is lost to rounding.
#pragma once
#include <Eigen/Geometry>
#include <vector>

#include "../base/types.h"
#include "closest.h"

namespace toile {

using Box = Eigen::AlignedBox3d;

Box face_box(const Vertices& V, const Faces& F, Eigen::Index face);

/// Median splits of the faces' centres. Nodes lie in preorder: the left child of `k` is `k + 1`.
/// The tree keeps the corners of its faces; `refit` moves them and keeps the splits.
class BoxTree {
public:
    struct Node {
        Box box;
        int begin = 0, end = 0;  ///< range in `order()`
        int right = -1;          ///< the right child; of a leaf, -1 - its number among leaves
        int wide = -1;           ///< number of the four-fold node that lists the children of its children
        bool leaf() const { return right < 0; }
        int size() const { return end - begin; }
    };
    struct Triangle {
        Vec3 a, b, c;
    };

    BoxTree(const Vertices& V, const Faces& F);

    /// New positions. Faces marked in `hidden` (per face; none when empty) meet nothing until the next call.
    void refit(const Vertices& V, const Faces& F, const std::vector<char>& hidden = {});

    const std::vector<Node>& nodes() const { return nodes_; }
    const std::vector<int>& order() const { return order_; }  ///< faces, leaf after leaf
    /// In the order of `order()`.
    const Triangle& triangle(int slot) const { return triangles_[static_cast<std::size_t>(slot)]; }
    const Box& box(int slot) const { return boxes_[static_cast<std::size_t>(slot)]; }  ///< empty for a hidden face
    int slot_of(int face) const { return slot_[static_cast<std::size_t>(face)]; }

    /// Calls `visit(slot)` for every face whose box meets the closed box, in no meaningful order.
    template <class Visit>
    void visit_overlapping(const Box& box, Visit&& visit) const;
    /// The closest point of all faces; the smallest face among those whose distances agree to 1e-9. A near `guess` saves
    /// time and changes nothing.
    SurfacePoint closest(const Vec3& p, int guess = -1) const;

private:
    using Lanes = double __attribute__((vector_size(32)));
    struct Pack {  ///< the faces of a leaf side by side: corners by axis; lanes beyond the last face repeat it
        Lanes a[3], b[3], c[3];
    };
    struct Wide {  ///< boxes of up to four nodes by axis; infinitely far where there is none
        Lanes low[3], high[3];
        int child[4];
    };
    static constexpr int stack_size = 64;  // median splits: 3 entries for every two levels of at most log2(2^31 / 4)
    struct Count {
        int nodes, leaves;
    };
    struct Centre {  ///< in float: only the splits depend on it
        float place[3];
        int face;
    };
    struct Part {  ///< faces [begin, end) of a node still to be built, and the number of its first leaf
        int node, begin, end, leaf;
    };
    static Count count(int faces);
    Part halve(Part& part, std::vector<Centre>& centres);
    void build(Part part, std::vector<Centre>& centres);
    void widen();
    static Lanes squared_distances(const Wide& node, const Vec3& p);
    static Lanes squared_distances(const Pack& t, const Vec3& p);

    std::vector<Node> nodes_;
    std::vector<int> order_, slot_;
    std::vector<int> leaf_;  ///< node of a face
    std::vector<Triangle> triangles_;
    std::vector<Box> boxes_;
    std::vector<Pack> packs_;  ///< per leaf
    std::vector<Wide> wide_;
};

template <class Visit>
void BoxTree::visit_overlapping(const Box& box, Visit&& visit) const {
    int stack[stack_size], top = 0;
    if (!nodes_.empty()) stack[top++] = 0;
    while (top > 0) {
        const Node& node = nodes_[static_cast<std::size_t>(stack[--top])];
        if (node.leaf()) {
            for (int k = node.begin; k < node.end; ++k)
                if (boxes_[static_cast<std::size_t>(k)].intersects(box)) visit(k);
            continue;
        }
        const Wide& wide = wide_[static_cast<std::size_t>(node.wide)];
        auto meets = wide.low[0] <= box.max()[0];
        for (int axis = 0; axis < 3; ++axis)
            meets &= (wide.low[axis] <= box.max()[axis]) & (wide.high[axis] >= box.min()[axis]);
        for (int lane = 0; lane < 4; ++lane)
            if (meets[lane]) stack[top++] = wide.child[lane];
    }
}

}  // namespace toile
