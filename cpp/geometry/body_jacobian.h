// A body in one pose, with derivatives of its points by pose and shape.
//
// Increments act on the left of a joint's local rotation, in its parent's axes: L_k <- exp([u_k]) L_k. A point y that
// bone weights tie to joints below k then moves by (R_parent u_k) x (sum_b w_b (p_b - x_k)), where p_b is where bone b
// alone would carry it and the sum runs over the bones at or below k.
#pragma once
#include <memory>
#include <vector>

#include "body_model.h"

namespace toile {

struct BodyState {
    std::vector<Mat3> local;  ///< per joint, relative to its parent, about world axes at rest
    Vec3 translation = Vec3::Zero();
    Vector shape;
};

/// What depends on the shape alone.
struct ShapedBody {
    ShapedBody(const BodyModel& model, const Vector& shape)
        : shape(shape), rest(shaped_vertices(model, shape)), J(shaped_joints(model, shape)) {}
    Vector shape;
    Vertices rest, J;  ///< (n,3), (K,3) [m]
};

/// Derivative of one scalar by (u_0 .. u_{K-1}, translation, shape); only the joints in `touched` are not zero.
struct BodyGradient {
    explicit BodyGradient(const BodyModel& model);
    void clear();
    Vector values;             ///< 3K + 3 + S
    std::vector<int> touched;  ///< joints, in the order of first touch
private:
    friend class PosedBody;
    std::vector<Vec3> moment_;
    std::vector<double> mass_;
    std::vector<char> marked_;
    std::vector<int> path_;
};

class PosedBody {
public:
    PosedBody(const BodyModel& model, const BodyState& state, bool shape_derivatives)
        : PosedBody(model, std::make_shared<ShapedBody>(model, state.shape), state, shape_derivatives) {}
    /// `shaped` is that of the state's shape.
    PosedBody(const BodyModel& model, std::shared_ptr<const ShapedBody> shaped, BodyState state,
              bool shape_derivatives);

    Vec3 vertex(int v) const;
    Vec3 joint(int k) const { return posed_.joints.row(k); }
    Vertices vertices() const;
    const BodyState& state() const { return state_; }

    void add_vertex(int v, const Vec3& direction, BodyGradient& out) const;  ///< out += d(direction . y_v)
    void add_joint(int k, const Vec3& direction, BodyGradient& out) const;   ///< out += d(direction . x_k)

private:
    const Mat3& parent_rotation(int k) const;
    void touch(int k, BodyGradient& out) const;

    const BodyModel& model_;
    BodyState state_;
    bool shape_derivatives_;
    std::shared_ptr<const ShapedBody> shaped_;
    Posed posed_;
    Matrix dx_, dc_;  ///< (3K,S): derivatives of x_k, and of x_k - R_k J_k, by shape
};

/// Rotation vector of a rotation, angle in [0, pi].
Vec3 rotation_log(const Mat3& R);
/// d log(exp([u]) R) / du at u = 0, for r = log R.
Mat3 log_jacobian(const Vec3& r);

}  // namespace toile
