// A skinned body model: linear shape basis, joints, and linear blend skinning with SMPL-style kinematics over
// world-aligned local rotations.
#pragma once
#include <string>
#include <vector>

#include "../base/types.h"

namespace toile {

/// Keypoints tie to a joint, or to a convex combination of vertices of the posed surface.
struct BodyKeypoint {
    std::string name;
    int joint = -1;               ///< used when >= 0
    std::vector<int> vertices;    ///< otherwise
    std::vector<double> weights;  ///< sum 1
};

struct BodyModel {
    Vertices v_template;          ///< (n,3) rest surface [m]
    Faces F;                      ///< (m,3)
    Vertices J;                   ///< (K,3) rest joints [m]
    std::vector<int> parents;     ///< (K,), parents[0] = -1, parents come before children
    Eigen::MatrixXi weights_idx;  ///< (n,B) joints per vertex
    Matrix weights_val;           ///< (n,B), rows sum to 1
    Matrix shapedirs;             ///< (3n,S), row 3 i + c
    Matrix J_shapedirs;           ///< (3K,S)
    std::vector<BodyKeypoint> keypoints;

    int joints() const { return static_cast<int>(parents.size()); }
    int shapes() const { return static_cast<int>(shapedirs.cols()); }
};

struct Posed {
    std::vector<Mat3> rotation;  ///< world rotation per joint
    Vertices joints;             ///< (K,3) [m]
};

/// Throws InputError unless the arrays agree in size, indices are in range and weights are finite and sum to 1.
void check_body_model(const std::string& kernel, const BodyModel& model);

/// v_template + shapedirs * shape.
Vertices shaped_vertices(const BodyModel& model, const Vector& shape);
Vertices shaped_joints(const BodyModel& model, const Vector& shape);

/// Forward kinematics: R_k = R_parent exp([r_k]), x_k = x_parent + R_parent (J_k - J_parent), x_0 = J_0 + translation.
Posed pose_joints(const std::vector<int>& parents, const Vertices& J, const std::vector<Mat3>& local,
                  const Vec3& translation);
Posed pose_joints(const std::vector<int>& parents, const Vertices& J, const Vertices& rotations,
                  const Vec3& translation);
std::vector<Mat3> rotation_matrices(const Vertices& rotations);

/// Linear blend skinning: sum_k w_k (R_k (v - J_k) + x_k).
Vertices skin_vertices(const BodyModel& model, const Vertices& rest, const Vertices& J, const Posed& posed);

/// The inverse of skin_vertices, per vertex.
Vertices unskin_vertices(const BodyModel& model, const Vertices& V, const Vertices& J, const Posed& posed);

Mat3 rotation_matrix(const Vec3& rotation_vector);

}  // namespace toile
