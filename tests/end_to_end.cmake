# Whole programs over LCM, each test in a private network namespace. 77: this machine does not allow one.
add_test(NAME end_to_end COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/end_to_end.sh
    $<TARGET_FILE:trocar-server> $<TARGET_FILE:trocar-device> ${PROJECT_SOURCE_DIR}/meshes/figure8.yaml)
if(TROCAR_SANITIZE)
    set(timing no) # instrumented programs are many times slower: their messages are checked, not their speed
else()
    set(timing yes)
endif()
set_tests_properties(end_to_end PROPERTIES ENVIRONMENT "TROCAR_CHECK_TIMING=${timing}" SKIP_RETURN_CODE 77 TIMEOUT 120 RUN_SERIAL TRUE)

# Faults injected into a running server, some of them through functions put around its own.
add_executable(faults faults.c)
target_link_libraries(faults PRIVATE trocar_service trocar_core trocar_types PkgConfig::CMOCKA m)
target_link_options(faults PRIVATE -Wl,--wrap=clock_gettime,--wrap=remesher_serve,--wrap=insertion_tick)
target_compile_definitions(faults PRIVATE MESHES="${PROJECT_SOURCE_DIR}/meshes")
add_test(NAME faults COMMAND ${PROJECT_SOURCE_DIR}/scripts/netns $<TARGET_FILE:faults>)
set_tests_properties(faults PROPERTIES ENVIRONMENT "TROCAR_CHECK_TIMING=${timing}" SKIP_RETURN_CODE 77 TIMEOUT 120 RUN_SERIAL TRUE)
