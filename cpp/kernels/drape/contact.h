// Keeps the vertices of a cloth out of a body that moves.
#pragma once
#include <vector>

#include "base/types.h"
#include "geometry/obstacle.h"

namespace toile {

/// The body goes linearly from one place to another within a step; `at` and `travelled` are shares of it, 0 to 1.
///
/// A vertex keeps the point of the body that was closest to it when it was last looked for, carried by its face, and the
/// direction from there. It may not come nearer than `margin` along that. As long as vertex and body have moved less than
/// the distance between them, nothing is looked for. On which side of a closed body it begins is told by winding numbers,
/// and after that by continuity.
class Contact {
public:
    Contact(const Faces& F, double margin, double friction, double max_depth)
        : F_(F), body_(F, max_depth), margin_(margin), friction_(friction) {}

    const Obstacle& body() const { return body_; }
    void place(const Vertices& body_V);  ///< the body jumps there
    void aim(const Vertices& body_V);    ///< where the step leads
    /// Finds the closest points at share `at`, of vertices that move (`w` > 0) and may, within `reach` (n,) [m], the way
    /// until the next call, meet the body.
    void look(const Vertices& x, const Vector& w, const Vector& reach, double at);
    void arrive();  ///< the step is done

    /// Pushes vertices that moved from `before` to x while the body moved on from share `from` to share `to`.
    void push(Vertices& x, const Vertices& before, double from, double to);
    /// Vertices that were pushed leave the body no faster than it moves.
    void take_bounce(Vertices& v, double from, double to, double h) const;

    double stride() const { return stride_; }  ///< of the fastest vertex of the body in the step [m]
    int contacts() const;
    int inside() const;

private:
    struct Near {
        int face = -1;
        Vec3 barycentric, outward, seen;  ///< `seen`: where the vertex was when it was looked for [m]
        double way = 0;                   ///< that the body had gone by then [m]
        double distance = 0;              ///< when it was looked for, negative inside [m]
        double room = 0;                  ///< how far vertex and body may move together before they can meet [m]
        bool bound = false;               ///< to stay outside: its face gives a direction
        bool pushed = false;              ///< in the last substep
    };
    static bool strayed(const Near& near, const Probe& probe, double moved);
    Vec3 carried(const Near& near, double at) const;  ///< the point of the body

    Faces F_;
    Obstacle body_;
    double margin_, friction_, stride_ = 0;
    double way_ = 0;  ///< of the body's fastest vertices in all steps that are done [m]
    Vertices from_, to_, now_;
    std::vector<Near> near_;
};

}  // namespace toile
