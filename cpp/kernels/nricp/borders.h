// Where the template ends, the scan ends: border curves of the one are pulled to those of the other.
#pragma once
#include "geometry/border.h"
#include "kernels/nricp/target.h"

namespace toile {

struct MatchSettings;
struct Pull;

/// The template's border curves, on vertices that can be seen.
struct TemplateBorders {
    std::vector<Border> curves;
    std::vector<int> vertices;  ///< ascending

    TemplateBorders() = default;
    TemplateBorders(const Vertices& V, const Vertices& N, const Faces& F, const Vector& seen);
};

/// The scan's border curves as targets of the template's.
class BorderTarget {
public:
    BorderTarget(const TemplateBorders& of_template, const NricpTarget& target);

    /// Pulls border vertices, but for those `bound` otherwise, across their curve to the nearest place where a curve of
    /// the scan that may be the same faces the same way.
    void pull(const Pose& pose, const MatchSettings& settings, const std::vector<char>& bound, Pull& pull) const;

private:
    struct Curve {
        Border border;
        Vertices place;  ///< smoothed, as the conormals are: borders of scans are zigzags
        double length;
        Vec3 facing;
        OrientedTree tree;
    };
    void pull_curve(const Border& own, const Pose& pose, const MatchSettings& settings, const std::vector<char>& bound,
                    Pull& pull) const;

    const TemplateBorders& borders_;
    const NricpTarget& target_;
    std::vector<Curve> curves_;
};

}  // namespace toile
