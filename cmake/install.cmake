# `cmake --install`: the library, its public headers and the package `toile` for find_package, with the target toile::core.
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

set(TOILE_HEADERS  # these include each other by relative paths, so that they are found wherever they lie
  base/errors.h
  base/pictures.h
  base/sparse.h
  base/stop.h
  base/types.h
  geometry/body_jacobian.h
  geometry/body_model.h
  geometry/box_tree.h
  geometry/closest.h
  geometry/intersect.h
  geometry/laplacian.h
  geometry/topology.h
  geometry/winding.h
  kernels/biharmonic.h
  kernels/contours.h
  kernels/drape.h
  kernels/inner.h
  kernels/mrf.h
  kernels/nricp.h
  kernels/occlusion.h
  kernels/paint.h
  kernels/raster.h
  kernels/remesh.h
  kernels/sight.h
  kernels/skeleton.h
  kernels/stereo.h
  kernels/untangle.h)
set(TOILE_PACKAGE_DIR ${CMAKE_INSTALL_LIBDIR}/cmake/toile)

add_library(toile::core ALIAS toile_core)
set_target_properties(toile_core PROPERTIES EXPORT_NAME core)
target_compile_features(toile_core PUBLIC cxx_std_20)
# Eigen's arrays pass between the library and its users, so both need one alignment and one instruction set.
# Its products open no teams of their own: their blocks depend on the number of threads, and a forked child waits for ever for a team.
target_compile_definitions(toile_core PUBLIC EIGEN_MAX_ALIGN_BYTES=32 EIGEN_DONT_PARALLELIZE)
target_compile_options(toile_core INTERFACE $<INSTALL_INTERFACE:-march=${TOILE_PROCESSOR}$<SEMICOLON>-ffp-contract=off>)

foreach(header IN LISTS TOILE_HEADERS)
  cmake_path(GET header PARENT_PATH room)
  install(FILES cpp/${header} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/toile/${room} COMPONENT cpp)
endforeach()
install(TARGETS toile_core EXPORT toile
  ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT cpp
  INCLUDES DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(EXPORT toile FILE toileTargets.cmake NAMESPACE toile:: DESTINATION ${TOILE_PACKAGE_DIR} COMPONENT cpp)
configure_package_config_file(cmake/toileConfig.cmake.in ${CMAKE_CURRENT_BINARY_DIR}/toileConfig.cmake
  INSTALL_DESTINATION ${TOILE_PACKAGE_DIR})
write_basic_package_version_file(${CMAKE_CURRENT_BINARY_DIR}/toileConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES
  cmake/FindCHOLMOD.cmake ${CMAKE_CURRENT_BINARY_DIR}/toileConfig.cmake ${CMAKE_CURRENT_BINARY_DIR}/toileConfigVersion.cmake
  DESTINATION ${TOILE_PACKAGE_DIR} COMPONENT cpp)
