// Arrays of the core: rows are items, metres, float64, C order.
#pragma once
#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <cstdint>
#include <string>
#include <vector>

namespace toile {

using Vec3 = Eigen::Vector3d;
using Mat3 = Eigen::Matrix3d;
using Vertices = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;     ///< (n,3) [m]
using Faces = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 3, Eigen::RowMajor>;  ///< (m,3) vertex indices
using Edges = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 2, Eigen::RowMajor>;  ///< (e,2) vertex indices
using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Vector = Eigen::VectorXd;
using Indices = Eigen::VectorXi;
using Sparse = Eigen::SparseMatrix<double>;  ///< column-major

/// Throws InputError "KERNEL: NAME[row] is not finite" for the first bad row.
void check_finite(const std::string& kernel, const std::string& name, const Eigen::Ref<const Matrix>& values);

/// Coordinates beyond this are refused: the squares of areas would leave the range of doubles, and answers turn to NaN.
constexpr double largest_coordinate = 1e50;

/// check_finite, and InputError for coordinates beyond `largest_coordinate`.
void check_points(const std::string& kernel, const std::string& name, const Eigen::Ref<const Matrix>& points);

/// Throws SolveError when values of the answer are not finite: options or sizes led beyond the range of doubles.
void check_solved(const std::string& kernel, const std::string& name, const Eigen::Ref<const Matrix>& values);

/// Throws InputError unless V holds points and is not empty and every index of F lies in [0, n).
void check_mesh(const std::string& kernel, const Vertices& V, const Faces& F, const std::string& name_V = "V",
                const std::string& name_F = "F");

/// Throws InputError unless every index of F lies in [0, n); `name_V` is empty where no vertices are given.
void check_faces(const std::string& kernel, const Faces& F, Eigen::Index n, const std::string& name_F = "F",
                 const std::string& name_V = "V");

/// Throws InputError unless every index lies in [0, n).
void check_indices(const std::string& kernel, const std::string& name, const Indices& indices, Eigen::Index n);

}  // namespace toile
