#include "bind/common.h"

namespace toile::bind {

void bind_nricp(py::module_&) {}

}  // namespace toile::bind
