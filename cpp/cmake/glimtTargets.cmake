# The targets glimt::glimt (static) and glimt::shared, of a build as of an installed tree. Both are for C: a C++
# program links them as well, and a program in C needs no C++ compiler for them.
function(glimt_targets static shared soname include)
  add_library(glimt::glimt STATIC IMPORTED GLOBAL)
  set_target_properties(glimt::glimt PROPERTIES
    IMPORTED_LOCATION ${static}
    INTERFACE_INCLUDE_DIRECTORIES ${include}
    IMPORTED_LINK_INTERFACE_LANGUAGES C
    INTERFACE_LINK_LIBRARIES "Threads::Threads;${CMAKE_DL_LIBS};m")
  add_library(glimt::shared SHARED IMPORTED GLOBAL)
  set_target_properties(glimt::shared PROPERTIES
    IMPORTED_LOCATION ${shared}
    IMPORTED_SONAME ${soname}
    INTERFACE_INCLUDE_DIRECTORIES ${include})
endfunction()
